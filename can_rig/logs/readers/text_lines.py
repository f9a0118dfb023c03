"""The lines of a text log on their way to python-can's reader, and what it skips without a word.

python-can's readers skip a line that they cannot read, and just stop where a file is cut off. Here
a line that has the form of a frame and gives no message is an error, and a missing end is noted.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any, Final, Self

from can import Message

from can_rig.errors import LogError
from can_rig.logs.log import Log
from can_rig.logs.readers.blocks import blocks
from can_rig.logs.readers.python_can import PIECE_MESSAGES, one_line_errors

_SHOWN: Final = 60  # characters of a bad line


class TextLines:
    """The lines of a text log, watched.

    Args:
        log: the log.
        frame: matches the lines of frames.
        after_header: a line put before the first frame.
        last_line: matches a line that is whole though the file ends without a newline.
    """

    def __init__(
        self,
        log: Log,
        frame: re.Pattern[str],
        after_header: str = "",
        last_line: re.Pattern[str] | None = None,
    ) -> None:
        self.header: list[str] = []
        """Lines before the first frame."""
        self.last = ""
        """The last line that is not blank."""
        self.file: Any = _LineFile(self._watched())
        """What a reader of python-can is given to read."""
        self._log = log
        self._frame = frame
        self._after_header = after_header
        self._last_line = last_line
        self._number = 0
        self._pending = False  # whether the line at hand is a frame that has not become a message

    def messages(self, reader: Iterable[Message]) -> Iterator[list[Message]]:
        """The messages that ``reader`` makes of ``file``, in pieces.

        Raises:
            LogError: a line is not a frame; file and line number.
        """
        messages = self._clearing(reader)
        while True:
            with one_line_errors(self._place):
                piece = list(islice(messages, PIECE_MESSAGES))
            if not piece:
                return
            yield piece

    def note(self, what: str) -> None:
        """Note that the end is missing, unless that has been noted."""
        self._log.notice = self._log.notice or f"{self._log.path}: {what}"

    def _place(self) -> str:
        return f"{self._log.path}: line {self._number}"

    def _not_a_frame(self) -> LogError:
        return LogError(f"{self._place()}: not a valid frame: {self.last[:_SHOWN]!r}")

    def _clearing(self, reader: Iterable[Message]) -> Iterator[Message]:
        """The messages; each acquits the line that it came from."""
        for message in reader:
            # python-can takes the bytes that are there, even if they are fewer than the length.
            if not message.is_remote_frame and len(message.data) != message.dlc:
                raise self._not_a_frame()
            self._pending = False
            yield message

    def _watched(self) -> Iterator[str]:
        frames = 0
        for line in self._whole():
            self._number += 1
            text = line.strip()
            if not text:
                continue  # it would end python-can's header
            self.last = text
            is_frame = bool(self._frame.match(text))
            if is_frame and not frames and self._after_header:
                yield self._after_header
            frames += is_frame
            if not frames:
                self.header.append(text)
            self._pending = is_frame
            yield text + "\n"
            if self._pending:
                raise self._not_a_frame()

    def _whole(self) -> Iterator[str]:
        """Every line that has its end."""
        tail = b""
        for block in blocks(self._log):
            *whole, tail = (tail + block).split(b"\n")
            for line in whole:
                yield line.decode("utf-8", "replace")
        text = tail.decode("utf-8", "replace")
        if text.endswith("\r") or (self._last_line and self._last_line.fullmatch(text)):
            yield text
        elif text.strip():
            self.note(
                f"line {self._number + 1}: the file ends within this line, which is ignored: "
                f"{text[:_SHOWN].strip()!r}"
            )


class _LineFile:
    """What python-can's readers need of a text file: its lines, and `close`."""

    def __init__(self, lines: Iterator[str]) -> None:
        self._lines = lines

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> str:
        return next(self._lines)

    def close(self) -> None:
        """Do nothing: the underlying file is closed at its end."""
