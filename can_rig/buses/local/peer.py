"""A sender's view of a listener on a local bus: a connection and a backlog."""

from __future__ import annotations

import errno
import socket
import threading
import time
from collections import deque
from typing import Final

GONE: Final = {errno.ECONNREFUSED, errno.ECONNRESET, errno.ENOTCONN, errno.EPIPE}
DONTWAIT: Final = int(socket.MSG_DONTWAIT)
RETRY_S: Final = 0.1  # how long a drainer waits for room until it checks whether to stop


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
        self.cut_off = False
        self._link = link
        self._limit = limit
        self._cut_off_notice = cut_off_notice
        self._backlog: deque[bytes] = deque()
        self._lock = threading.Lock()  # taken only for a present or imminent backlog
        self._drainer: threading.Thread | None = None
        self._closing = False

    def offer(self, frame: bytes) -> bool:
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
            self._backlog.append(self._cut_off_notice if self.cut_off else frame)
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
