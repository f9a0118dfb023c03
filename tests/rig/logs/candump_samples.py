"""Lines that candump writes, and their frames as plain values."""

from pathlib import Path

from can_rig.logs.frames import Frames, concatenate
from can_rig.logs.reading import read_log

# Of can-utils 2020.11: candump -L, candump -l of a socket with error frames and FD, and log2asc's
# example; 2023: the R or T that -x adds, and a raw DLC above 8.
CANDUMP = """\
(1436509052.249713) vcan0 044#2A366C2BBA
(1436509052.449847) vcan0 0F6#7ADFE07BD2
(1436509052.650004) can1 12345678#R
(1436509052.850189) can1 123#R4
(1436509053.050404) vcan0 00000555#
(1436509053.250570) vcan0 5A1##0
(1436509053.451125) vcan0 5A1##3112233445566778899AABBCCDDEEFF
(1436509053.651227) vcan0 1F334455##11122334455667788
(1436509053.651229) can1 20000088#0000080000000000
(1436509053.651231) can1 20000004#000C000000006000
(1436509053.851336) vcan0 4F8#DE AD
"""
GOOD = CANDUMP.replace("DE AD", "DEAD")
DIRECTED = (
    "".join(f"{line} {'RT'[at % 2]}\n" for at, line in enumerate(GOOD.splitlines()))
    + "(1436509055.000001) can1 123#1122334455667788_B R\n"
)


def written(folder: Path, text: str | bytes, name: str = "a.log") -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def whole(path: Path, chunk_frames: int = 1 << 18) -> Frames:
    return concatenate(read_log(path, chunk_frames))


def rows(frames: Frames) -> list[tuple]:
    """Every frame as plain values, channels by name."""
    return [
        (*start, frames.channels[bus], length, data.tobytes().rstrip(b"\0"))
        for (*start, bus, length), data in zip(frames.rows(), frames.data, strict=True)
    ]
