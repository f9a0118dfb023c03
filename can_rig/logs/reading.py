"""Logs of any common format as columns of frames, chunk by chunk.

    for frames in read_log(Path("drive.log")):
        print(len(frames), frames.time_ns[0])

| suffix            | format                     |
|-------------------|----------------------------|
| `.log`, `.log.gz` | candump -L, candump -l     |
| `.asc`, `.asc.gz` | Vector ASCII               |
| `.blf`            | Vector binary logging      |
| `.trc`, `.trc.gz` | PEAK trace                 |
| `.mf4`            | ASAM MDF 4, bus logging    |
| `.csv`, `.csv.gz` | SavvyCAN (GVRET)           |
| any text          | BUSMASTER, by its heading; Microchip, CARBUS Analyzer |

Time stamps are integers in nanoseconds, read digit by digit; only an `.mf4` may have them in float
seconds since the start of the recording, which are rounded to the nearest nanosecond.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final

from can_rig.logs.formats import BUSMASTER, MICROCHIP, format_in
from can_rig.logs.frames import Frames
from can_rig.logs.log import ALL, Log, Window
from can_rig.logs.readers.binary.blf import read_blf
from can_rig.logs.readers.binary.mf4 import read_mf4
from can_rig.logs.readers.text.formats.asc import read_asc
from can_rig.logs.readers.text.formats.busmaster import read_busmaster
from can_rig.logs.readers.text.formats.candump import read_candump
from can_rig.logs.readers.text.formats.gvret import read_gvret
from can_rig.logs.readers.text.formats.trc import read_microchip, read_trc

_READERS: Final[Mapping[str, Callable[[Log], Iterator[Frames]]]] = {
    ".log": read_candump,
    ".asc": read_asc,
    ".blf": read_blf,
    ".trc": read_trc,
    ".mf4": read_mf4,
    ".csv": read_gvret,
    BUSMASTER: read_busmaster,
    MICROCHIP: read_microchip,
}


def read_log(path: str | Path, chunk_frames: int = 1 << 18, window: Window = ALL) -> Log:
    """The log at ``path``; every iteration reads the file.

    Args:
        path: a log of a supported format; text may be gzipped. The first bytes decide the format,
            or else the suffix.
        chunk_frames: largest number of frames in a chunk, which bounds the memory.
        window: the part of the recording to read.

    Raises:
        LogError: neither the first bytes nor the suffix belong to a log.
    """
    path = Path(path)
    kind = format_in(path)
    return Log(path, _READERS[kind], chunk_frames, kind, window)
