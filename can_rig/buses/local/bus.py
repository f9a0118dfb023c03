"""CAN between processes without root or kernel module: the python-can interface ``local``.

A bus is a directory, and a node is an AF_UNIX datagram socket in the directory. The kernel thus
keeps the frames of all senders in one queue per listener, lossless and in order. A sender keeps a
connected socket per listener; frames that do not fit into a listener's queue wait in the sender's
memory.

A sender reads the directory again whenever the count in its file ``.can-generation`` has changed.
Every node maps the count file. A joining node binds its socket, then increments the count before
its constructor returns: a sender only reads a word of memory, without a system call, and cannot
miss a node. A lock on the file orders joining, leaving and the removal of dead sockets.

A frame is a datagram: a header of fixed size, then the payload. A burst is a datagram of several
classic frames of 8 bytes. Only nodes that have joined for bursts get bursts; every other node gets
each frame of a burst as a datagram, so its descriptor is readable while frames wait.
"""

import contextlib
import errno
import fcntl
import logging
import mmap
import os
import re
import secrets
import select
import socket
import stat
import struct
import tempfile
import threading
import time
from collections import deque
from collections.abc import Container, Iterator
from pathlib import Path
from typing import Any, Final

from can import (
    BusABC,
    CanInitializationError,
    CanOperationError,
    CanProtocol,
    CanTimeoutError,
    Message,
)
from can.typechecking import AutoDetectedConfig, Channel

RETRY_S: Final = 0.1  # how long a drainer waits for room until it checks whether to stop
GENERATION: Final = ".can-generation"
NODE_NAME: Final = re.compile(r"\d+[-+][0-9a-f]{6}\.node")
"""Process id, whether the node takes bursts, and a random part."""
PATH_MAX: Final = 107 - len("/4194304-012345.node")  # sun_path holds 107 bytes and a NUL


def bus_root() -> Path:
    """The directory with this user's named buses."""
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    if runtime.startswith("/") and os.access(runtime, os.W_OK | os.X_OK):
        return Path(runtime) / "can-rig"
    return Path(tempfile.gettempdir()) / f"can-rig-{os.getuid()}"


class Directory:
    """The directory of a bus.

    Raises:
        CanInitializationError: the channel cannot be a directory, or its path is too long.
    """

    def __init__(self, channel: str) -> None:
        root = bus_root()
        self._named = not channel.startswith("/")
        if self._named and (not channel or "/" in channel or channel.startswith(".")):
            raise CanInitializationError(
                f"local bus {channel!r}: the channel must be a name without '/' or an absolute path"
            )
        self._path = root / channel
        excess = len(os.fsencode(self._path)) - PATH_MAX
        if excess > 0:
            raise CanInitializationError(
                f"path of the local bus is {excess} bytes too long for a socket: {self._path}"
            )
        if self._named:
            root.mkdir(mode=0o700, exist_ok=True)
            status = root.lstat()
            if status.st_uid != os.getuid() or stat.S_IMODE(status.st_mode) & 0o077:
                raise CanInitializationError(f"{root} must be a private directory of this user")
            for other in root.iterdir():
                if other != self._path:
                    _remove_if_abandoned(other)
        self._file = self._open_locked()
        # The view keeps the memory mapped for a send() after shutdown().
        self.generation = memoryview(mmap.mmap(self._file, 8)).cast("Q")

    def _open_locked(self) -> int:
        while True:
            self._path.mkdir(mode=0o700, exist_ok=True)
            # the last node has just removed the directory
            with contextlib.suppress(FileNotFoundError):
                file = os.open(self._path / GENERATION, os.O_RDWR | os.O_CREAT, mode=0o600)
                fcntl.flock(file, fcntl.LOCK_EX)
                status = os.fstat(file)
                if status.st_nlink:
                    if status.st_size == 0:  # written, because a hole on a full disk is a SIGBUS
                        os.write(file, bytes(8))
                    return file
                os.close(file)

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        fcntl.flock(self._file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            fcntl.flock(self._file, fcntl.LOCK_UN)

    def join(self, bursts: bool = False) -> tuple[socket.socket, str]:
        """Bind and count the socket of a new node; return the socket and its name."""
        name = f"{os.getpid()}{'+' if bursts else '-'}{secrets.token_hex(3)}.node"
        node = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        with self._locked():
            node.bind(str(self._path / name))
            self.generation[0] += 1
        return node, name

    def connect_all_but(self, known: Container[str]) -> dict[str, socket.socket]:
        """Connected sockets to the nodes not ``known``, by name; removes sockets of dead nodes."""
        links = {}
        # within the lock a socket without a listener is dead, never half-bound
        with self._locked():
            for name in _nodes(self._path):
                if name in known:
                    continue
                link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
                if not _connected(link, self._path / name):
                    link.close()
                    self.remove(name)
                    continue
                timeval = struct.pack("ll", 0, round(RETRY_S * 1e6))
                link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, timeval)
                links[name] = link
        return links

    def remove(self, name: str) -> None:
        """Remove the socket of a node, whose name is never used again."""
        (self._path / name).unlink(missing_ok=True)

    def leave(self, name: str) -> None:
        """Remove the socket of a node, and after the last one on a named bus its directory."""
        for link in self.connect_all_but(known=()).values():  # and so removes dead ones
            link.close()
        with self._locked():
            self.remove(name)
            if self._named and not _nodes(self._path):
                _take_away(self._path)

    def close(self) -> None:
        """Close the file of the count; the memory stays mapped."""
        os.close(self._file)


def _remove_if_abandoned(path: Path) -> None:
    """Remove the directory of a bus after all its nodes were killed."""
    with contextlib.suppress(OSError), contextlib.ExitStack() as stack:
        if path.is_symlink() or not path.is_dir():
            return
        try:
            file = os.open(path / GENERATION, os.O_RDWR | os.O_NOFOLLOW)
        except FileNotFoundError:  # killed, or just now interrupted, between making the two
            path.rmdir()
            return
        stack.callback(os.close, file)
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # a joining or leaving node holds the lock
        if os.fstat(file).st_nlink == 0:
            return
        nodes = _nodes(path)
        for name in nodes:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
                if _connected(link, path / name):
                    return
        for name in nodes:
            (path / name).unlink(missing_ok=True)
        _take_away(path)


def takes_bursts(name: str) -> bool:
    """Whether the node with this name takes several frames in one datagram."""
    return "+" in name


def _nodes(path: Path) -> list[str]:
    """Names of the nodes' sockets, including dead sockets."""
    with contextlib.suppress(FileNotFoundError):
        return [
            each.name
            for each in path.iterdir()
            if NODE_NAME.fullmatch(each.name) and each.is_socket()
        ]
    return []


def _connected(link: socket.socket, node: Path) -> bool:
    """Connect to a node; False if it is dead."""
    try:
        link.connect(str(node))
    except (ConnectionRefusedError, FileNotFoundError):
        return False
    return True


def _take_away(path: Path) -> None:
    """Remove the directory of a bus without nodes."""
    (path / GENERATION).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # something else is in it
        path.rmdir()


HEADER: Final = struct.Struct("<dIBBxx")
"""Time stamp [s], identifier, flags, DLC."""

PLAIN_BYTES: Final = HEADER.size + 8
"""Length of a classic frame of 8 bytes."""

BURST_MOST: Final = 4
"""Frames of the longest burst."""

MAX_BYTES: Final = max(HEADER.size + 64, BURST_MOST * PLAIN_BYTES)
_BURSTS: Final = {count * PLAIN_BYTES for count in range(2, BURST_MOST + 1)}
_FLAGS_AT: Final = 12

EXTENDED, REMOTE, ERROR, FD, BRS, ESI, OWN, CUT_OFF = (1 << bit for bit in range(8))
"""Flags. OWN: sent by the receiver itself; CUT_OFF: not a frame, but a sender's last datagram."""

CUT_OFF_NOTICE: Final = HEADER.pack(0.0, 0, CUT_OFF, 0)
"""A sender's notice to a listener before cutting the listener off."""


def frames_of(datagram: bytes) -> list[bytes]:
    """The frames of a datagram."""
    if len(datagram) not in _BURSTS or datagram[_FLAGS_AT] & FD:
        return [datagram]
    return [datagram[at : at + PLAIN_BYTES] for at in range(0, len(datagram), PLAIN_BYTES)]


def flags_of(msg: Message) -> int:
    """The flags of a frame other than a plain data frame."""
    return (
        EXTENDED * msg.is_extended_id
        | REMOTE * msg.is_remote_frame
        | ERROR * msg.is_error_frame
        | FD * msg.is_fd
        | BRS * msg.bitrate_switch
        | ESI * msg.error_state_indicator
    )


def message(datagram: bytes, channel: str) -> tuple[Message, int]:
    """The frame of a datagram, and its flags."""
    timestamp, identifier, flags, dlc = HEADER.unpack_from(datagram)
    data = bytearray(datagram[HEADER.size :])
    if not flags:
        return Message(timestamp, identifier, False, False, False, channel, dlc, data), 0
    return Message(
        timestamp=timestamp,
        arbitration_id=identifier,
        is_extended_id=bool(flags & EXTENDED),
        is_remote_frame=bool(flags & REMOTE),
        is_error_frame=bool(flags & ERROR),
        channel=channel,
        dlc=dlc,
        data=data,
        is_fd=bool(flags & FD),
        is_rx=not flags & OWN,
        bitrate_switch=bool(flags & BRS),
        error_state_indicator=bool(flags & ESI),
    ), flags


GONE: Final = {errno.ECONNREFUSED, errno.ECONNRESET, errno.ENOTCONN, errno.EPIPE}
DONTWAIT: Final = int(socket.MSG_DONTWAIT)


class Peer:
    """A listener: a connected socket, and the frames waiting for room in its queue.

    Args:
        name: of its socket.
        link: connected to it.
        limit: number of frames that may wait.
        cut_off_notice: sent after the backlog when the backlog is full.
    """

    def __init__(self, name: str, link: socket.socket, limit: int, cut_off_notice: bytes) -> None:
        self.name = name
        self.takes_bursts = takes_bursts(name)
        self.cut_off = False
        self._link = link
        self._limit = limit
        self._cut_off_notice = cut_off_notice
        self._backlog: deque[bytes] = deque()
        self._lock = threading.Lock()  # taken only for a present or imminent backlog
        self._drainer: threading.Thread | None = None
        self._closing = False

    def offer(self, frame: bytes | memoryview) -> bool:
        """Send a frame now or after the backlog; False if the listener is gone or cut off."""
        if not self._backlog:
            try:
                self._link.send(frame, DONTWAIT)
            except BlockingIOError:
                pass
            except OSError as error:
                if error.errno in GONE:
                    return False
            else:
                return True
        with self._lock:
            if self.cut_off:
                return True  # another thread has just cut the listener off, and reports the cut
            self.cut_off = len(self._backlog) >= self._limit
            self._backlog.append(self._cut_off_notice if self.cut_off else bytes(frame))
            if self._drainer is None:
                self._drainer = threading.Thread(target=self._drain, daemon=True)
                self._drainer.start()
        return not self.cut_off

    def _drain(self) -> None:
        while True:
            with self._lock:
                if not self._backlog or self._closing:
                    self._drainer = None
                    return
            # The frame stays in the backlog until sent, so that no other frame overtakes.
            try:
                self._link.send(self._backlog[0])
            except BlockingIOError:  # SO_SNDTIMEO has passed
                continue
            except OSError as error:
                if error.errno in GONE:
                    # the next offer() fails likewise, and reports the failure
                    self._backlog.clear()
                else:
                    time.sleep(RETRY_S)  # the kernel is short of memory
            else:
                self._backlog.popleft()

    def discard(self) -> None:
        """Empty the backlog, except for a frame that another thread may be sending."""
        with self._lock:
            while len(self._backlog) > 1:
                self._backlog.pop()

    def wait_until_drained(self, deadline: float) -> bool:
        """Wait until the backlog is empty, at most until ``deadline`` (monotonic, in s)."""
        drainer = self._drainer
        if drainer is not None:
            drainer.join(max(0.0, deadline - time.monotonic()))
        return not self._backlog

    def close(self, deadline: float) -> int:
        """Close when the backlog is drained, or at ``deadline``; returns the frames never sent."""
        if not self.cut_off:
            self.wait_until_drained(deadline)
        drainer, self._closing = self._drainer, True
        if drainer is not None:
            drainer.join(10 * RETRY_S)  # its send() must not outlive the descriptor
        self._link.close()
        return len(self._backlog)


log = logging.getLogger(__name__)

DEFAULT_CHANNEL: Final = "rig"

_SHUTDOWN_S: Final = 2.0  # waiting time of shutdown() for listeners to take sent frames
_COARSE_S: Final = 0.05  # SO_RCVTIMEO counts in jiffies of 4 ms; select() does shorter timeouts


class LocalBus(BusABC):
    """A node on a bus of this machine; lossless, in order, for any number of listeners.

    Args:
        channel: a name, or the absolute path of a directory; equal for all nodes of a bus.
        receive_own_messages: also deliver this node's frames to the node, ``is_rx=False``.
        preserve_timestamps: send ``Message.timestamp`` instead of the time of sending.
        fd: CAN FD; without ``fd``, `send` refuses and ``recv`` skips FD frames.
        tx_backlog: number of waiting frames per listener, in addition to the kernel's queue. A
            listener with more unread frames is cut off and cannot stop the other listeners: the
            sender logs a warning and continues; the listener gets every frame sent before the cut,
            followed by a `can.CanOperationError`. For flow control, call `send` with a timeout.
        bursts: join for bursts, which `recv_burst` reads whole and ``recv`` frame by frame; the
            descriptor then is not readable for the later frames of a burst.
        **kwargs: as of `can.BusABC`; like other buses, ignores what python-can's own programs give
            to every bus.

    Raises:
        can.CanInitializationError: an unusable directory, or a path that is too long.
    """

    def __init__(
        self,
        channel: Channel = DEFAULT_CHANNEL,
        receive_own_messages: bool = False,
        preserve_timestamps: bool = False,
        fd: bool = False,
        tx_backlog: int = 200_000,
        bursts: bool = False,
        **kwargs: Any,
    ) -> None:
        if not isinstance(tx_backlog, int):
            raise CanInitializationError(f"tx_backlog = {tx_backlog!r}: must be a whole number")
        self.channel = str(channel)
        self.channel_info = f"local bus {self.channel}"
        self.receive_own_messages = receive_own_messages
        self.preserve_timestamps = preserve_timestamps
        self._can_protocol = CanProtocol.CAN_FD if fd else CanProtocol.CAN_20
        self._tx_backlog = tx_backlog
        self._rescan_lock = threading.Lock()
        # including cut-off listeners, against finding these listeners again
        self._known: dict[str, Peer] = {}
        self._peers: tuple[Peer, ...] = ()
        self._own: Peer | None = None
        self._timeout: float | None = None  # the value of SO_RCVTIMEO
        self._seen = -1
        self._unread: deque[bytes] = deque()  # frames of a datagram that has been read
        self.bursts = bursts and not (receive_own_messages or preserve_timestamps)
        """Whether `send_burst` and `recv_burst` may be called."""
        try:
            self._directory = Directory(self.channel)
            self._socket, self._name = self._directory.join(self.bursts)
        except OSError as error:
            message = f"cannot join local bus {self.channel}: {error}"
            raise CanInitializationError(message) from error
        self._generation = self._directory.generation
        super().__init__(channel=channel, **kwargs)

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Send a frame to every other node; never waits for a listener without a ``timeout``.

        Args:
            msg: the frame.
            timeout: if > 0, how long to wait until every earlier frame is in its listener's queue
                [s].

        Raises:
            can.CanTimeoutError: no room in time; no node received the frame.
            can.CanOperationError: the frame is not a CAN frame, or the bus is closed.
        """
        if self._generation[0] != self._seen:
            self._rescan()
        if timeout and timeout > 0:
            self._wait_for_room(timeout)

        identifier, dlc, data, flags = msg.arbitration_id, msg.dlc, msg.data, 0
        if msg.is_extended_id or msg.is_remote_frame or msg.is_error_frame or msg.is_fd:
            flags = flags_of(msg)
        if flags or dlc > 8 or dlc != len(data) or not 0 <= identifier <= 0x7FF:
            self._check(msg)  # a plain frame needs no check: this is the hot path
        timestamp = msg.timestamp if self.preserve_timestamps else time.time()
        frame = HEADER.pack(timestamp, identifier, flags, dlc) + data

        for peer in self._peers:
            if not peer.offer(frame):
                self._drop(peer)
        if self._own is not None:
            frame = HEADER.pack(timestamp, identifier, flags | OWN, dlc) + data
            if not self._own.offer(frame):
                self._drop(self._own)

    def send_burst(self, frames: memoryview) -> None:
        """Send classic frames of 8 bytes, each after its header, as `send` does.

        Raises:
            can.CanOperationError: the bus is closed.
        """
        if self._generation[0] != self._seen:
            self._rescan()
        for peer in self._peers:
            for part in (frames,) if peer.takes_bursts else frames_of(bytes(frames)):
                if not peer.offer(part):
                    self._drop(peer)
                    break

    def recv_burst(self, buffer: memoryview, timeout: float) -> int:
        """Read the next datagram, at most ``MAX_BYTES``, into ``buffer``.

        Args:
            buffer: for the datagram.
            timeout: in seconds, at least 0.05.

        Returns:
            the length; 0 after a timeout or an error, and while ``recv`` has frames of a datagram.
        """
        if self._unread:
            return 0
        try:
            if timeout != self._timeout:
                self._set_receive_timeout(timeout)
            return self._socket.recv_into(buffer)
        except OSError:
            return 0

    def unread(self, datagram: bytes) -> None:
        """Give back a datagram from ``recv_burst``, so that ``recv`` finds its frames."""
        self._unread.extend(frames_of(datagram))

    def recv(self, timeout: float | None = None) -> Message | None:
        """As `can.BusABC.recv`, but faster by a sixth while no filter is set."""
        if self._filters is None:
            return self._recv_internal(timeout)[0]
        return super().recv(timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        received, flags = self._receive(timeout)
        if flags & FD and self._can_protocol is not CanProtocol.CAN_FD:  # counts as never sent
            end_s = None if timeout is None else time.monotonic() + timeout
            while flags & FD:
                left_s = None if end_s is None else max(0.0, end_s - time.monotonic())
                received, flags = self._receive(left_s)
        return received, False

    def _receive(self, timeout: float | None) -> tuple[Message | None, int]:
        """The next frame of either protocol, and its flags."""
        try:
            if self._unread:
                datagram = self._unread.popleft()
            elif timeout is None or timeout >= _COARSE_S:
                if timeout != self._timeout:
                    self._set_receive_timeout(timeout)
                datagram = self._socket.recv(MAX_BYTES)
            else:
                if timeout > 0:
                    select.select((self._socket,), (), (), timeout)
                datagram = self._socket.recv(MAX_BYTES, DONTWAIT)
        except BlockingIOError:
            return None, 0
        except (OSError, ValueError) as error:  # ValueError: select() on a closed socket
            self._check_if_open()
            raise CanOperationError(f"cannot receive from {self}: {error}") from error
        if not datagram:  # the signal of shutdown() in another thread to a waiting receiver
            self._check_if_open()
        if self.bursts and len(datagram) in _BURSTS:
            datagram, *others = frames_of(datagram)
            self._unread.extend(others)
        received, flags = message(datagram, self.channel)
        if flags & CUT_OFF:
            raise CanOperationError(f"cut off from a sender on {self}: too many frames unread")
        return received, flags

    def fileno(self) -> int:
        """The descriptor, readable while frames wait; -1 once closed."""
        return self._socket.fileno()

    def flush_tx_buffer(self) -> None:
        """Discard the frames waiting for room in listeners' queues."""
        for peer in self._peers:
            peer.discard()

    def shutdown(self) -> None:
        """Leave the bus; wait up to 2 s until listeners take the sent frames, otherwise warn."""
        if self._is_shutdown:
            return
        super().shutdown()
        self._seen = -1  # so that the next send() finds the bus closed
        self._directory.leave(self._name)
        self._socket.shutdown(socket.SHUT_RD)  # senders stop waiting for this node
        deadline = time.monotonic() + _SHUTDOWN_S
        for peer in self._known.values():
            if lost := peer.close(deadline):
                log.warning("%s: %d frames were never read by %s", self, lost, peer.name)
        self._known.clear()
        self._list_peers()
        self._socket.close()
        self._directory.close()

    @staticmethod
    def _detect_available_configs() -> list[AutoDetectedConfig]:
        """The default bus, and every named bus with a node."""
        names = {node.parent.name for node in bus_root().glob("*/*.node")}
        channels = sorted(names | {DEFAULT_CHANNEL})
        return [{"interface": "local", "channel": name} for name in channels]

    def _check_if_open(self) -> None:
        if self._is_shutdown:
            raise CanOperationError("Cannot operate on a closed bus")

    def _check(self, msg: Message) -> None:
        if msg.is_fd and self._can_protocol is not CanProtocol.CAN_FD:
            raise CanOperationError("cannot send FD message over bus with CAN FD disabled")
        try:
            msg._check()
        except ValueError as error:
            raise CanOperationError(f"not a CAN frame: {error}") from error

    def _set_receive_timeout(self, timeout: float | None) -> None:
        # settimeout() would make the socket non-blocking, at the cost of a poll() per recv().
        seconds, microseconds = divmod(round((timeout or 0) * 1e6), 1_000_000)
        timeval = struct.pack("ll", seconds, microseconds)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeval)
        self._timeout = timeout

    def _rescan(self) -> None:
        """Connect to the nodes that joined since the last scan."""
        with self._rescan_lock:
            self._check_if_open()
            # before the directory: a node that joins later changes the count
            seen = self._generation[0]
            known = {*self._known} if self.receive_own_messages else {*self._known, self._name}
            try:
                links = self._directory.connect_all_but(known)
            except OSError as error:
                raise CanOperationError(f"cannot list the nodes on {self}: {error}") from error
            for name, link in links.items():
                self._known[name] = Peer(name, link, self._tx_backlog, CUT_OFF_NOTICE)
            self._list_peers()
            self._seen = seen

    def _list_peers(self) -> None:
        peers = {name: peer for name, peer in self._known.items() if not peer.cut_off}
        self._own = peers.pop(self._name, None)
        self._peers = tuple(peers.values())

    def _wait_for_room(self, timeout: float) -> None:
        deadline = time.monotonic() + timeout
        for peer in self._peers:
            if not peer.wait_until_drained(deadline):
                raise CanTimeoutError(f"{peer.name} on {self} took no frame within {timeout} s")

    def _drop(self, peer: Peer) -> None:
        with self._rescan_lock:
            if peer.cut_off:
                log.warning(
                    "%s: %s left %d frames unread and is cut off", self, peer.name, self._tx_backlog
                )
            elif self._known.pop(peer.name, None):
                peer.close(deadline=0.0)
                self._directory.remove(peer.name)  # a killed node; one that leaves does this itself
            self._list_peers()
