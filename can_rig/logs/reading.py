"""Logs of any common format as columns of frames, chunk by chunk.

    for frames in read_log(Path("drive.log")):
        print(len(frames), frames.time_ns[0])

| suffix            | format                     | read by                                  |
|-------------------|----------------------------|------------------------------------------|
| `.log`, `.log.gz` | candump -L, candump -l     | `readers.candump`, exact to 1 ns         |
| `.asc`, `.asc.gz` | Vector ASCII               | python-can                               |
| `.blf`            | Vector binary logging      | python-can                               |
| `.trc`, `.trc.gz` | PEAK trace                 | python-can                               |
| `.mf4`            | ASAM MDF 4, bus logging    | asammdf                                  |

Time stamps are integers in nanoseconds. Those of a candump log are read digit by digit; the other
readers give float seconds since the start of the recording, which are rounded to the nearest
nanosecond and added to the start.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final

from can_rig.logs.formats import format_of
from can_rig.logs.frames import Frames
from can_rig.logs.log import Log
from can_rig.logs.readers.binary.blf import read_blf
from can_rig.logs.readers.binary.mf4 import read_mf4
from can_rig.logs.readers.text.asc import read_asc
from can_rig.logs.readers.text.candump import read_candump
from can_rig.logs.readers.text.trc import read_trc

_READERS: Final[Mapping[str, Callable[[Log], Iterator[Frames]]]] = {
    ".log": read_candump,
    ".asc": read_asc,
    ".blf": read_blf,
    ".trc": read_trc,
    ".mf4": read_mf4,
}


def read_log(path: str | Path, chunk_frames: int = 1 << 18) -> Log:
    """The log at ``path``, in the format of its suffix; iterating over it reads the file.

    Args:
        path: ``.log``, ``.asc``, ``.blf``, ``.trc`` or ``.mf4``; text formats also with ``.gz``.
        chunk_frames: largest number of frames in a chunk, which bounds the memory.

    Raises:
        LogError: the suffix is not one of a log.
    """
    path = Path(path)
    return Log(path, _READERS[format_of(path)], chunk_frames)
