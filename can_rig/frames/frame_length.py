"""The most bits that a frame of a length takes on the wire.

After five equal bits the sender inserts one of the other value, which itself counts towards the
next five (ISO 11898-1, bit stuffing). The stuffed bits, and the remaining bits:

| frame       | dynamically stuffed, s bytes of data                              |
|-------------|-------------------------------------------------------------------|
| classic, 11 | SOF ID RTR IDE r0 DLC data CRC: 34 + 8 s bits                     |
| classic, 29 | SOF ID SRR IDE ID RTR r1 r0 DLC data CRC: 54 + 8 s                |
| FD, 11      | SOF ID RRS IDE FDF res BRS ESI DLC data: 22 + 8 s                 |
| FD, 29      | SOF ID SRR IDE ID RRS FDF res BRS ESI DLC data: 41 + 8 s          |

In FD frames a stuff count of 4 bits and a CRC of 17 follow, of 21 above 16 bytes, with a fixed
stuff bit before their first bit and after every fourth. All frames end in 10 bits without stuffing:
CRC delimiter, ACK slot, ACK delimiter, and seven for the end of frame.

A remote frame counts as a classic frame with s = 0. The intermission of 3 bits separates frames:
`FrameBits` excludes the intermission, `duration_s` and `on_the_bus` add the 3 bits.
"""

from fractions import Fraction
from functools import cache
from typing import Final, NamedTuple

from can_rig.errors import RigError
from can_rig.frames.foreign_frames import FD_LENGTHS

INTERMISSION_BITS: Final = 3
"""Recessive bits after the end of frame before the next start of frame."""

CLASSIC_BYTES: Final = 8

_TAIL_BITS: Final = 10  # CRC delimiter, ACK slot, ACK delimiter, end of frame
_STUFF_COUNT_BITS: Final = 4  # three, Gray-coded, and their parity
_ARBITRATION_BITS: Final = 17, 36  # of an FD frame from the start of frame to BRS, unstuffed
_LENGTH_OF_CRC_17: Final = 16  # longest data of an FD frame with the short CRC [bytes]


class FrameError(RigError):
    """A frame or a bit rate outside the CAN standard."""


class FrameBits(NamedTuple):
    """Length of a frame from its start-of-frame bit to the last of its end-of-frame bits."""

    nominal: int
    """Bits at the nominal bit rate: all bits, unless the frame switches its bit rate."""
    data: int = 0
    """Bits at the data bit rate."""

    @property
    def total(self) -> int:
        """All bits, without the intermission."""
        return self.nominal + self.data

    @property
    def on_the_bus(self) -> int:
        """All bits until the next frame can start: with the intermission."""
        return self.total + INTERMISSION_BITS

    def duration_s(self, bitrate: int, data_bitrate: int | None = None) -> Fraction:
        """How long until the next frame can start [s], exactly.

        Args:
            bitrate: nominal bit rate [bit/s].
            data_bitrate: of the data phase [bit/s]; None where no frame switches.

        Raises:
            FrameError: a bit rate not above 0; a data bit rate missing or below the nominal one.
        """
        if bitrate <= 0:
            raise FrameError(f"bit rate {bitrate} bit/s: must be above 0")
        duration = Fraction(self.nominal + INTERMISSION_BITS, bitrate)
        if self.data:
            if data_bitrate is None or data_bitrate < bitrate:
                raise FrameError(
                    f"data bit rate {data_bitrate} bit/s: must be the nominal one ({bitrate}) or "
                    "above for frames that switch"
                )
            duration += Fraction(self.data, data_bitrate)
        return duration


@cache
def worst_case_bits(
    length: int,
    *,
    extended: bool = False,
    remote: bool = False,
    fd: bool = False,
    brs: bool = False,
) -> FrameBits:
    """The largest number of bits of a frame with `length` bytes, for any contents.

    n stuffable bits take at most (n - 1) // 4 stuff bits: one after the first five bits, then one
    after every four bits. Including the intermission, a classic frame has (Davis et al. 2007) g + 8
    s + 13 + (g + 8 s - 1) // 4 bits, g = 34 or 54. In FD frames the first fixed stuff bit replaces
    a stuff bit after the last bit, giving (n - 2) // 4.

    The rate switches at the sample points of BRS and of the CRC delimiter, so both bits are partly
    nominal and partly data. Together both bits last one bit of each rate, for any sample points.
    Here BRS counts as nominal.

    Raises:
        FrameError: a length outside the standard.
    """
    if length not in (FD_LENGTHS if fd else range(CLASSIC_BYTES + 1)):
        kind = "an FD" if fd else "a classic"
        possible = "0 to 8, 12, 16, 20, 24, 32, 48 or 64" if fd else "0 to 8"
        raise FrameError(f"{kind} frame of {length} bytes: must have {possible}")
    if not fd:
        bits = (54 if extended else 34) + (0 if remote else 8 * length)
        return FrameBits(bits + (bits - 1) // 4 + _TAIL_BITS)
    arbitration = _ARBITRATION_BITS[extended]
    early = (arbitration - 2) // 4  # all at the slower rate, the longest duration
    late = (arbitration + 5 + 8 * length - 2) // 4 - early
    crc = 17 if length <= _LENGTH_OF_CRC_17 else 21
    check = _STUFF_COUNT_BITS + crc
    fixed = -(-check // 4)  # a stuff bit before the first bit and after every fourth bit
    nominal = arbitration + early + _TAIL_BITS - 1
    data = 1 + 4 + 8 * length + late + check + fixed + 1  # ESI, DLC, ..., CRC delimiter
    return FrameBits(nominal, data) if brs else FrameBits(nominal + data)
