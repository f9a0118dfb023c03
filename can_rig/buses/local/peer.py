"""A listener on a local bus as a sender sees it."""

import errno
import socket
import threading
import time
from collections import deque

GONE = {errno.ECONNREFUSED, errno.ECONNRESET, errno.ENOTCONN, errno.EPIPE}
DONTWAIT = int(socket.MSG_DONTWAIT)
RETRY_S = 0.1  # how long a drainer waits for room before it looks whether it has to end


class Peer:
    """A listener as a sender sees it: a connected socket and the frames that wait for room."""

    def __init__(self, name: str, link: socket.socket, limit: int, last_frame: bytes) -> None:
        self.name = name
        self.cut_off = False
        self._link = link
        self._limit = limit
        self._last_frame = last_frame
        self._backlog: deque[bytes] = deque()
        self._lock = threading.Lock()  # taken only by who finds or leaves a backlog
        self._drainer: threading.Thread | None = None
        self._closing = False

    def offer(self, frame: bytes) -> bool:
        """Deliver a frame, now or in its turn; False if there will be no more for this one."""
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
                return True  # another thread has just found that out, and reports it
            self.cut_off = len(self._backlog) >= self._limit
            self._backlog.append(self._last_frame if self.cut_off else frame)
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
                if error.errno in GONE:
                    self._backlog.clear()  # the next offer() meets the same error and reports it
                else:
                    time.sleep(RETRY_S)  # the kernel is short of memory
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
            drainer.join(10 * RETRY_S)  # its send() must not outlive the descriptor
        self._link.close()
        return len(self._backlog)
