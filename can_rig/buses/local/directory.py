"""The nodes on a local bus: the directory of their sockets, and a count of all joins."""

from __future__ import annotations

import contextlib
import fcntl
import mmap
import os
import re
import secrets
import socket
import stat
import struct
import tempfile
from collections.abc import Container, Iterator
from pathlib import Path
from typing import Final

from can import CanInitializationError

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
