"""CAN between processes without root or kernel module: the python-can interface ``local``.

A bus is a directory and a node is an AF_UNIX datagram socket in it, so that the kernel keeps the
frames of all senders in one queue per listener, lossless and in order. A sender keeps a connected
socket per listener; frames that a full queue refuses wait in the sender's memory.

Who is on the bus is read from the directory whenever the count in its file ``.can-generation`` has
moved. Every node maps that file and raises the count when it joins, after it has bound its socket
and before its constructor returns: a sender looks at a word of memory, needs no system call, and
cannot miss a node. The file's lock orders joining, leaving and the removal of dead sockets.
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
from typing import Any

from can import (
    BusABC,
    CanInitializationError,
    CanOperationError,
    CanProtocol,
    CanTimeoutError,
    Message,
)
from can.typechecking import AutoDetectedConfig, Channel

log = logging.getLogger(__name__)

DEFAULT_CHANNEL = "rig"

_HEADER = struct.Struct("<dIBB")  # timestamp in s, identifier, flags, DLC; the data follow
_DATAGRAM_MAX = _HEADER.size + 64
_EXTENDED, _REMOTE, _ERROR, _FD, _BRS, _ESI, _OWN, _CUT_OFF = (1 << bit for bit in range(8))
_LAST_FRAME = _HEADER.pack(0.0, 0, _CUT_OFF, 0)

_GENERATION = ".can-generation"
_NODE_NAME = re.compile(r"\d+-[0-9a-f]{6}\.node")  # process id, then what tells its nodes apart
_PATH_MAX = 107 - len("/4194304-012345.node")  # sun_path holds 107 bytes and a NUL

_GONE = {errno.ECONNREFUSED, errno.ECONNRESET, errno.ENOTCONN, errno.EPIPE}

_RETRY_S = 0.1  # how long a drainer waits for room before it looks whether it has to end
_SHUTDOWN_S = 2.0  # how long shutdown() waits for listeners to take what was sent
_COARSE_S = 0.05  # SO_RCVTIMEO counts in jiffies of 4 ms; shorter timeouts go through select()


def bus_root() -> Path:
    """The directory that holds the named buses of this user."""
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    if runtime.startswith("/") and os.access(runtime, os.W_OK | os.X_OK):
        return Path(runtime) / "can-rig"
    return Path(tempfile.gettempdir()) / f"can-rig-{os.getuid()}"


class LocalBus(BusABC):
    """A node on a bus of this machine; lossless, in order, for any number of listeners.

    :param channel: a name, or an absolute path of a directory. Nodes with the same one meet.
    :param receive_own_messages: deliver the frames of this node to itself too, ``is_rx=False``.
    :param preserve_timestamps: send ``Message.timestamp`` instead of the time of sending.
    :param fd: CAN FD; without it FD frames are refused by :meth:`send` and skipped by ``recv``.
    :param tx_backlog: frames that may wait for one listener, beside the kernel's queue. A
        listener that leaves more unread is cut off, so that it cannot stop the others: the sender
        logs a warning and goes on, the listener gets every frame up to there and then a
        :exc:`~can.CanOperationError`. For flow control give :meth:`send` a timeout.
    :raises ~can.CanInitializationError: the directory is unusable or its path too long.
    """

    def __init__(
        self,
        channel: Channel = DEFAULT_CHANNEL,
        receive_own_messages: bool = False,
        preserve_timestamps: bool = False,
        fd: bool = False,
        tx_backlog: int = 200_000,
        **kwargs: Any,
    ) -> None:
        self.channel = str(channel)
        self.channel_info = f"local bus {self.channel}"
        self.receive_own_messages = receive_own_messages
        self.preserve_timestamps = preserve_timestamps
        self._can_protocol = CanProtocol.CAN_FD if fd else CanProtocol.CAN_20
        self._tx_backlog = tx_backlog
        self._rescan_lock = threading.Lock()
        self._known: dict[str, _Peer] = {}  # cut-off listeners stay, not to be found anew
        self._peers: tuple[_Peer, ...] = ()
        self._own: _Peer | None = None
        self._timeout: float | None = None  # what SO_RCVTIMEO is set to
        self._seen = -1
        try:
            self._directory = _Directory(self.channel)
            self._socket, self._name = self._directory.join()
        except OSError as error:
            message = f"cannot join local bus {self.channel}: {error}"
            raise CanInitializationError(message) from error
        self._generation = self._directory.generation
        super().__init__(channel=channel, **kwargs)

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Hand a frame to every other node; never waits for a listener unless told to.

        :param timeout: if > 0, wait up to this many seconds until no earlier frame waits for room
            in a listener's queue.
        :raises ~can.CanTimeoutError: there was no room in time; the frame went to nobody.
        :raises ~can.CanOperationError: the frame is not a CAN frame, or the bus is closed.
        """
        if self._generation[0] != self._seen:
            self._rescan()
        if timeout and timeout > 0:
            self._wait_for_room(timeout)

        flags = _EXTENDED if msg.is_extended_id else 0
        if msg.is_remote_frame:
            flags |= _REMOTE
        if msg.is_error_frame:
            flags |= _ERROR
        if msg.is_fd:
            flags |= _FD
        if msg.bitrate_switch:
            flags |= _BRS
        if msg.error_state_indicator:
            flags |= _ESI
        identifier, dlc, data = msg.arbitration_id, msg.dlc, msg.data
        if flags or dlc > 8 or dlc != len(data) or not 0 <= identifier <= 0x7FF:
            self._check(msg)  # everything but the plain frame of the hot path
        timestamp = msg.timestamp if self.preserve_timestamps else time.time()
        frame = _HEADER.pack(timestamp, identifier, flags, dlc) + data

        for peer in self._peers:
            if not peer.offer(frame):
                self._drop(peer)
        if self._own is not None:
            frame = _HEADER.pack(timestamp, identifier, flags | _OWN, dlc) + data
            if not self._own.offer(frame):
                self._drop(self._own)

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        try:
            if timeout is None or timeout >= _COARSE_S:
                if timeout != self._timeout:
                    self._set_receive_timeout(timeout)
                datagram = self._socket.recv(_DATAGRAM_MAX)
            else:
                if timeout > 0:
                    select.select((self._socket,), (), (), timeout)
                datagram = self._socket.recv(_DATAGRAM_MAX, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None, False
        except (OSError, ValueError) as error:  # ValueError: select() on a closed socket
            self._check_if_open()
            raise CanOperationError(f"cannot receive from {self}: {error}") from error
        if not datagram:  # shutdown() in another thread wakes a waiting receiver so
            self._check_if_open()

        timestamp, identifier, flags, dlc = _HEADER.unpack_from(datagram)
        data = bytearray(datagram[_HEADER.size :])
        if not flags:
            return Message(
                timestamp, identifier, False, False, False, self.channel, dlc, data
            ), False
        if flags & _CUT_OFF:
            raise CanOperationError(f"cut off from a sender on {self}: too many frames unread")
        if flags & _FD and self._can_protocol is not CanProtocol.CAN_FD:
            return None, False
        return Message(
            timestamp=timestamp,
            arbitration_id=identifier,
            is_extended_id=bool(flags & _EXTENDED),
            is_remote_frame=bool(flags & _REMOTE),
            is_error_frame=bool(flags & _ERROR),
            channel=self.channel,
            dlc=dlc,
            data=data,
            is_fd=bool(flags & _FD),
            is_rx=not flags & _OWN,
            bitrate_switch=bool(flags & _BRS),
            error_state_indicator=bool(flags & _ESI),
        ), False

    def fileno(self) -> int:
        """The descriptor that is readable while frames wait; -1 once closed."""
        return self._socket.fileno()

    def flush_tx_buffer(self) -> None:
        """Discard the frames that wait for room in listeners' queues."""
        for peer in self._peers:
            peer.discard()

    def shutdown(self) -> None:
        """Leave the bus; waits up to 2 s for listeners to take what was sent, then warns."""
        if self._is_shutdown:
            return
        super().shutdown()
        self._seen = -1  # the next send looks, and finds the bus closed
        self._directory.leave(self._name)
        self._socket.shutdown(socket.SHUT_RD)  # senders see it, and wait no longer for this node
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
        """The default bus, and every named bus that has a node."""
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
        # Not settimeout(): that makes the socket non-blocking and costs a poll() per recv().
        seconds, microseconds = divmod(round((timeout or 0) * 1e6), 1_000_000)
        timeval = struct.pack("ll", seconds, microseconds)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeval)
        self._timeout = timeout

    def _rescan(self) -> None:
        """Connect to the nodes that have joined since the last look."""
        with self._rescan_lock:
            self._check_if_open()
            seen = self._generation[0]  # before the directory: a later joiner moves it again
            known = {*self._known} if self.receive_own_messages else {*self._known, self._name}
            try:
                links = self._directory.connect_all_but(known)
            except OSError as error:
                raise CanOperationError(f"cannot look who is on {self}: {error}") from error
            for name, link in links.items():
                self._known[name] = _Peer(name, link, self._tx_backlog)
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

    def _drop(self, peer: "_Peer") -> None:
        with self._rescan_lock:
            if peer.cut_off:
                log.warning(
                    "%s: %s left %d frames unread and is cut off", self, peer.name, self._tx_backlog
                )
            elif self._known.pop(peer.name, None):
                peer.close(deadline=0.0)
                self._directory.remove(peer.name)  # of a killed node; one that left did so itself
            self._list_peers()


class _Peer:
    """A listener as a sender sees it: a connected socket and the frames that wait for room."""

    def __init__(self, name: str, link: socket.socket, limit: int) -> None:
        self.name = name
        self.cut_off = False
        self._link = link
        self._limit = limit
        self._backlog: deque[bytes] = deque()
        self._lock = threading.Lock()  # taken only by who finds or leaves a backlog
        self._drainer: threading.Thread | None = None
        self._closing = False

    def offer(self, frame: bytes) -> bool:
        """Deliver a frame, now or in its turn; False if there will be no more for this one."""
        if not self._backlog:
            try:
                self._link.send(frame, socket.MSG_DONTWAIT)
            except BlockingIOError:
                pass
            except OSError as error:
                if error.errno in _GONE:
                    return False
            else:
                return True
        with self._lock:
            if self.cut_off:
                return True  # another thread has just found that out, and reports it
            self.cut_off = len(self._backlog) >= self._limit
            self._backlog.append(_LAST_FRAME if self.cut_off else frame)
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
            # The frame stays in the backlog until it is sent, so that none can overtake it.
            try:
                self._link.send(self._backlog[0])
            except BlockingIOError:  # SO_SNDTIMEO has passed
                continue
            except OSError as error:
                if error.errno in _GONE:
                    self._backlog.clear()  # the next offer() meets the same error and reports it
                else:
                    time.sleep(_RETRY_S)  # the kernel is short of memory
            else:
                self._backlog.popleft()

    def discard(self) -> None:
        """Empty the backlog, save the frame that may be on its way."""
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
        """Close, after the backlog is drained or at ``deadline``; returns frames never sent."""
        if not self.cut_off:
            self.wait_until_drained(deadline)
        drainer, self._closing = self._drainer, True
        if drainer is not None:
            drainer.join(10 * _RETRY_S)  # its send() must not outlive the descriptor
        self._link.close()
        return len(self._backlog)


class _Directory:
    """The directory of a bus: who is there, and the count that moves when one joins."""

    def __init__(self, channel: str) -> None:
        root = bus_root()
        self._named = not channel.startswith("/")
        if self._named and (not channel or "/" in channel or channel.startswith(".")):
            raise CanInitializationError(
                f"local bus {channel!r} is neither a name without '/' nor an absolute path"
            )
        self._path = root / channel
        excess = len(os.fsencode(self._path)) - _PATH_MAX
        if excess > 0:
            raise CanInitializationError(
                f"path of local bus is {excess} bytes too long for a socket: {self._path}"
            )
        if self._named:
            root.mkdir(mode=0o700, exist_ok=True)
            status = root.lstat()
            if status.st_uid != os.getuid() or stat.S_IMODE(status.st_mode) & 0o077:
                raise CanInitializationError(f"{root} is not a private directory of this user")
        self._file = self._open_locked()
        # The view keeps the map alive, for the look of a send() after shutdown().
        self.generation = memoryview(mmap.mmap(self._file, 8)).cast("Q")

    def _open_locked(self) -> int:
        while True:
            self._path.mkdir(mode=0o700, exist_ok=True)
            with contextlib.suppress(FileNotFoundError):  # the last node has just taken it away
                file = os.open(self._path / _GENERATION, os.O_RDWR | os.O_CREAT, mode=0o600)
                fcntl.flock(file, fcntl.LOCK_EX)
                status = os.fstat(file)
                if status.st_nlink:
                    if status.st_size == 0:  # written, for a hole that no disk backs is a SIGBUS
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

    def join(self) -> tuple[socket.socket, str]:
        """Bind a new node's socket and let the others know; returns it with its name."""
        name = f"{os.getpid()}-{secrets.token_hex(3)}.node"
        node = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        with self._locked():
            node.bind(str(self._path / name))
            self.generation[0] += 1
        return node, name

    def connect_all_but(self, known: Container[str]) -> dict[str, socket.socket]:
        """Links to the nodes that are not ``known``, by name; removes sockets of dead nodes."""
        links = {}
        with self._locked():  # a socket without a listener is dead, not one about to be bound
            for name in self._nodes():
                if name in known:
                    continue
                link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
                try:
                    link.connect(str(self._path / name))
                except (ConnectionRefusedError, FileNotFoundError):
                    link.close()
                    self.remove(name)
                    continue
                timeval = struct.pack("ll", 0, round(_RETRY_S * 1e6))
                link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, timeval)
                links[name] = link
        return links

    def _nodes(self) -> list[str]:
        with contextlib.suppress(FileNotFoundError):
            return [
                path.name
                for path in self._path.iterdir()
                if _NODE_NAME.fullmatch(path.name) and path.is_socket()
            ]
        return []

    def remove(self, name: str) -> None:
        """Unlink a node's socket; names are never used again."""
        (self._path / name).unlink(missing_ok=True)

    def leave(self, name: str) -> None:
        """Remove a node's socket, and with the last one of a named bus the directory."""
        with self._locked():
            self.remove(name)
            if self._named and not self._nodes():
                (self._path / _GENERATION).unlink(missing_ok=True)
                with contextlib.suppress(OSError):  # something else lies there
                    self._path.rmdir()

    def close(self) -> None:
        os.close(self._file)
