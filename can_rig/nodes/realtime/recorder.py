"""``bus.log`` in real time: written by a thread, so that a slow disk delays no tick."""

from __future__ import annotations

import threading
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType
from typing import Self

from can_rig.errors import RunFolderError
from can_rig.nodes.recording.recorder import CandumpLines, LogFile


class RealTimeRecorder:
    """Writes candump lines with the time since the start of the run.

    ``at`` sets the time of the next frame, sent or read. ``flush`` gives the thread all recorded
    lines, which reach the disk some 0.1 ms later.

    Raises:
        RunFolderError: the file cannot be opened or written.
    """

    def __init__(self, path: Path) -> None:
        self._file = LogFile(path)
        self._lines = CandumpLines()
        self.record = self._lines.record
        self._queue: SimpleQueue[list[str]] = SimpleQueue()  # an empty list is the last
        self._writer: threading.Thread | None = None
        self._failure: RunFolderError | None = None

    def at(self, time_ns: int) -> None:
        """Set the next frame's time since the start; times never decrease."""
        self._lines.at(time_ns // 1000)

    def flush(self) -> None:
        """Give the recorded lines to the thread, which inherits this thread's scheduling.

        Raises:
            RunFolderError: writing has failed since the last call.
        """
        if self._failure is not None:
            raise self._failure
        lines = self._lines.take()
        if not lines:
            return
        if self._writer is None:
            self._writer = threading.Thread(target=self._write_all, daemon=True)
            self._writer.start()
        self._queue.put(lines)

    def _write_all(self) -> None:
        while (lines := self._queue.get()) and self._failure is None:
            try:
                self._file.write(lines)
            except RunFolderError as failure:
                self._failure = failure

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.flush()
            if self._writer is not None:
                self._queue.put([])
                self._writer.join()
            if self._failure is not None:
                raise self._failure
        finally:
            self._file.close()
