"""The frames of a scenario as C: the numbers of each frame, and what packs and unpacks its bytes.

`support/frames.c` converts between a value and its steps, `network.c` between steps and bytes.
"""

import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Final

from can_rig.drawing.names import Signal
from can_rig.errors import ExportError
from can_rig.export.c_files import WIDTH, comment, plain
from can_rig.frames.codec import FRAME_BYTES, MessageCodec
from can_rig.frames.frame_columns import CRC_TABLES
from can_rig.frames.network import Network
from can_rig.scenario.build import dbc_of, heard_by_law
from can_rig.scenario.sensor_settings import HEARD, SAMPLE_TICKS
from can_rig.scenario.settings import Scenario

SENT: Final = ("command_1", "command_2", "status")
CODES: Final = {"tick": 16, "mode": 32, "fault_state": 32, "verdict": 32}
"""The other content of a frame, and how many of its bits count."""
FLOATS: Final = {
    "<f": {"of": "float", "bits": "uint32_t", "nan": "0x7FC00000u"},
    "<d": {"of": "double", "bits": "uint64_t", "nan": "UINT64_C(0x7FF8000000000000)"},
}
TO_FLOAT: Final = """
/* The bits of a value as a {of}, within the range. */
static {bits} bits_of_{of}(const struct frame *frame, real value)
{{
    const double below = (double)value > frame->most ? frame->most : (double)value;
    const {of} number = ({of})(below < -frame->most ? -frame->most : below);
    {bits} bits = {nan};

    if (isnan(value) == 0) {{
        (void)memcpy((uint8_t *)&bits, (const uint8_t *)&number, sizeof bits);
    }}
    return bits;
}}
"""
FROM_FLOAT: Final = """
/* The value of the bits of a {of}; NAN outside the range. */
static real value_of_{of}(const struct frame *frame, {bits} bits)
{{
    {of} number;

    (void)memcpy((uint8_t *)&number, (const uint8_t *)&bits, sizeof number);
    return fabs((double)number) <= frame->most ? (real)number : (real)NAN;
}}
"""


def sensors_of(
    scenario: Scenario, network: Network
) -> list[tuple[int, MessageCodec, tuple[int, int, int]]]:
    """Number, frame and timing of each sensor that the law hears."""
    return [
        (HEARD.index(sensor.measures) + 1, codec, sensor.timing(scenario.tick_s))
        for sensor, codec in heard_by_law(scenario, network)
    ]


def frame_bytes(network: Network) -> int:
    """The room that the node in C has for a frame."""
    return max(FRAME_BYTES, *(codec.layout.length for codec in network.on_the_bus))


def signal_comment(
    codec: MessageCodec, signal: Signal | None = None, limit: float | None = None
) -> str:
    """Unit, meaning and range of a frame's only signal, for the plant.

    ``limit`` bounds a command, though the frame could express more.
    """
    unit, name = codec.unit, codec.signal_name
    if signal is not None:
        unit = signal.unit
        name = f"{signal.name} ({name})" if signal.name else name
    most = codec.maximum if limit is None else min(limit, codec.maximum)
    least = codec.minimum if limit is None else max(-limit, codec.minimum)
    said = f"[{unit}] {name}" if unit else name
    steps = f", steps of {codec.lsb:g}" if codec.lsb else ""
    return plain(f"{said}, {least:.10g}..{most:.10g}{steps}")


class NetworkCode:
    """The frames of ``network`` as C.

    Raises:
        ExportError: a signal that the node in C cannot carry.
    """

    def __init__(self, scenario: Scenario, network: Network) -> None:
        self._scenario, self._network = scenario, network
        self._sensors = sensors_of(scenario, network)
        frames = (*network.by_role, *(codec for _, codec, _ in self._sensors))
        self._frames = frames
        for codec in frames:
            if codec.float_format and codec.float_format not in FLOATS:
                raise ExportError(
                    f"{dbc_of(scenario)}: message {codec.name}: signal {codec.signal_name} is a "
                    "float of 16 bits: must have 32 or 64 bits in the ECU in C"
                )
        single = scenario.design.precision == "float32"
        wide = any(len(codec.layout.places["value"]) > 32 for codec in frames)
        self._word_bits = 64 if wide else 32
        self._whole = {codec.role: _steps_per_unit(codec) if single else 0 for codec in frames}
        counted = {bool(self._whole[each.role]) for each in frames if each.lsb and _is_sent(each)}
        self.texts: Final = {
            "word": f"uint{self._word_bits}_t",
            "frame_bytes": str(frame_bytes(network)),
            "sensors": str(len(self._sensors)),
        }
        """Texts of the handwritten files."""
        parts = {
            "steps": any(codec.lsb for codec in frames),
            "counts": bool(counted),
            "whole": True in counted,
            "divides": False in counted,
            "floats": any(codec.float_format for codec in frames),
            "extended": any(codec.extended for codec in frames),
            "fd": any(codec.fd for codec in frames),
        }
        self.parts: Final = {name for name, there in parts.items() if there}
        """Parts of the handwritten files."""

    def source(self) -> str:
        """``network.c``: the frames, and the period."""
        scenario, frames = self._scenario, self._frames
        lines = [*comment(f"The frames of {dbc_of(scenario).name}."), '#include "ecu.h"']
        if "floats" in self.parts:
            lines += ["", "#include <string.h>"]
        lines += ["", f"const uint32_t ecu_tick_us = {round(scenario.tick_s * 1e6)};"]
        used = dict.fromkeys((_is_sent(each), each.float_format) for each in frames)
        for sent, form in used:
            if form:
                lines += (TO_FLOAT if sent else FROM_FLOAT).format(**FLOATS[form]).splitlines()
        for codec in frames:
            lines += ["", *comment(f"{codec.name}: {signal_comment(codec)}")]
            lines += self._pack(codec) if _is_sent(codec) else self._unpack(codec)
        for codec in self._network.by_role:
            lines += ["", f"const struct frame frame_{codec.role} = {{"]
            lines += [f"    {each}" for each in self._numbers(codec)] + ["};"]
        if self._sensors:
            lines += ["", "const struct ecu_sensor_frame ecu_sensors[ECU_SENSORS] = {"]
        for number, codec, (period, phase, _) in self._sensors:
            lines += ["    {", "        .frame = {"]
            lines += [f"            {each}" for each in self._numbers(codec)] + ["        },"]
            lines.append(f"        .number = {number}, .period = {period}u, .phase = {phase}u,")
            if codec.modes:
                lines.append(f"        .valid = 1u, .largest = {SAMPLE_TICKS - 1}u,")
            lines.append("    },")
        lines += ["};"] * bool(self._sensors)
        return "\n".join([*lines, "", f"const uint32_t ecu_crc_of_frames = {self._crc()};"]) + "\n"

    def _crc(self) -> str:
        """CRC-32 of all numbers and of the CRC-8 of each byte, as ``ecu.c`` computes it."""
        numbers: list[float] = [round(self._scenario.tick_s * 1e6)]
        for codec in self._network.by_role:
            numbers += self._guarded(codec)
        for number, codec, (period, phase, _) in self._sensors:
            valid, largest = (1, SAMPLE_TICKS - 1) if codec.modes else (0, 0)
            numbers += [*self._guarded(codec), number, period, phase, valid, largest]
        numbers += CRC_TABLES[-1].tolist()
        guarded = (struct.pack("<d" if isinstance(each, float) else "<Q", each) for each in numbers)
        return f"0x{zlib.crc32(b''.join(guarded)):08X}u"

    def _guarded(self, codec: MessageCodec) -> list[float]:
        """The numbers of a ``struct frame``; an absent one is 0."""
        sent, words, counts = _is_sent(codec), 1 << self._word_bits, not codec.float_format
        numbers: list[float] = [
            codec.frame_id | codec.extended << 31 | codec.fd << 30,
            codec.data_id or 0,
            codec.layout.length,
        ]
        if "steps" in self.parts:
            numbers.append(float(codec.lsb) if counts else 0.0)
            ends = (-codec.raw_minimum, codec.raw_maximum, codec.not_available if sent else 0)
            numbers += [int(each) % words if counts else 0 for each in ends]
        if "whole" in self.parts:
            numbers.append(self._whole[codec.role] if sent and counts else 0)
        if "floats" in self.parts:
            numbers.append(0.0 if counts else float(codec.raw_maximum))
        return numbers

    def _numbers(self, codec: MessageCodec) -> list[str]:
        """The initialisers of a ``struct frame``."""
        sent, whole = _is_sent(codec), self._whole[codec.role]
        flags = ["FRAME_EXTENDED"] * codec.extended + ["FRAME_FD"] * codec.fd
        numbers = {
            "id": " | ".join([f"0x{codec.frame_id:X}u", *flags]),
            "data_id": f"0x{codec.data_id or 0:X}",
            "bytes": str(codec.layout.length),
        }
        if codec.float_format:
            numbers["most"] = repr(float(codec.raw_maximum))
        else:
            numbers["lsb"] = repr(codec.lsb)
            numbers["lowest"] = self._word(int(-codec.raw_minimum))
            numbers["highest"] = self._word(int(codec.raw_maximum))
            if sent:
                numbers["not_available"] = self._word(int(codec.not_available))
            if sent and whole:
                numbers["steps_per_unit"] = f"{whole}u"
        direction = "pack" if sent else "unpack"
        numbers[direction] = f"{direction}_{codec.role}"
        return [f".{name} = {value}," for name, value in numbers.items()]

    def _word(self, number: int) -> str:
        """A two's complement."""
        number %= 1 << self._word_bits
        return f"UINT64_C({number})" if self._word_bits > 32 else f"{number}u"

    def _pack(self, codec: MessageCodec) -> list[str]:
        places, (sign, from_zero, _) = codec.layout.places, codec.layout.coding
        if codec.float_format:
            kind = FLOATS[codec.float_format]["bits"]
            raw = f"bits_of_{FLOATS[codec.float_format]['of']}(frame, content->value)"
        else:
            kind, how = self.texts["word"], "whole_" if self._whole[codec.role] else ""
            raw = f"frame_{how}steps(frame, content->value)"
            raw = f"0u - {raw}" if sign < 0 else raw
            raw += f" - {self._word(from_zero)}" if from_zero else ""
        parts: defaultdict[int, list[str]] = defaultdict(list)
        rest = bytearray(codec.layout.pack(0, 0, 0, 0, 0))
        for name, bits in places.items():
            word = "raw" if name == "value" else f"content->{name}"
            for byte, low, count, shift in _pieces(bits[: CODES.get(name)]):
                part = f"({word} >> {shift})" if shift else word
                part = f"{part} & 0x{(1 << count) - 1:X}u"
                parts[byte].append(f"({part}) << {low}" if low else part)
            for bit in bits:
                rest[bit // 8] &= ~(1 << bit % 8)
        lines = []
        for byte, constant in enumerate(rest):
            found = [*parts[byte], *([f"0x{constant:X}u"] if constant else [])]
            if len(found) > 1:
                found = [f"({each})" for each in found]
            if found:
                lines += _joined(f"    data[{byte}] = (uint8_t)(", found, ");")
        return [
            f"static void pack_{codec.role}(const struct frame *frame,",
            f"{'':{len(codec.role) + 18}}const struct frame_content *content, uint8_t *data)",
            *("{", f"    const {kind} raw = {raw};", "", *lines, "}"),
        ]

    def _unpack(self, codec: MessageCodec) -> list[str]:
        places, (sign, from_zero, is_signed) = codec.layout.places, codec.layout.coding
        form, word = codec.float_format, self.texts["word"]
        kind = FLOATS[form]["bits"] if form else word
        lines = _read(f"const {kind} raw = ", places["value"], kind)
        if form:
            value = f"value_of_{FLOATS[form]['of']}(frame, raw)"
        else:
            steps, length = "raw", len(places["value"])
            if is_signed and length < self._word_bits:
                top = 1 << length - 1
                steps, from_zero = f"(raw ^ {self._word(top)})", from_zero - top
            steps += f" + {self._word(from_zero)}" if from_zero else ""
            value = f"frame_value(frame, {f'0u - ({steps})' if sign < 0 else steps})"
        lines += ["", f"    content->value = {value};"]
        for name, of in CODES.items():
            if bits := places.get(name, ())[:of]:
                lines += _read(f"content->{name} = ", bits, "uint32_t")
        return [
            f"static void unpack_{codec.role}(const struct frame *frame, const uint8_t *data,",
            f"{'':{len(codec.role) + 20}}struct frame_content *content)",
            *("{", *lines, "}"),
        ]


def _is_sent(codec: MessageCodec) -> bool:
    return codec.role in SENT


def _pieces(bits: Sequence[int]) -> Iterator[tuple[int, int, int, int]]:
    """Byte, lowest bit there, number of bits and place in the signal, of bits in one byte."""
    first = 0
    for at in range(1, len(bits) + 1):
        if at == len(bits) or bits[at] // 8 != bits[first] // 8:
            yield bits[first] // 8, bits[first] % 8, at - first, first
            first = at


def _read(begin: str, bits: Sequence[int], kind: str) -> list[str]:
    """A statement that reads a number from its bits."""
    parts = []
    for byte, low, count, shift in _pieces(bits):
        part = f"({kind})data[{byte}]"
        part = f"({part} >> {low})" if low else part
        part = f"({part} & 0x{(1 << count) - 1:X}u)" if low + count < 8 else part
        parts.append(f"({part} << {shift})" if shift else part)
    return _joined(f"    {begin}", parts, ";")


def _joined(begin: str, parts: list[str], end: str) -> list[str]:
    """A statement of the or of ``parts``, in lines."""
    lines = [begin]
    for number, part in enumerate(parts):
        last = number == len(parts) - 1
        if len(lines[-1]) + len(part) + 4 > WIDTH:
            lines[-1] = lines[-1].rstrip()
            lines.append("        ")
        lines[-1] += part + (end if last else " | ")
    return lines


def _steps_per_unit(codec: MessageCodec) -> int:
    """1/lsb, where whole numbers of single precision give the steps of the rig; else 0.

    The rig divides in double precision. A value is m/2^e with m below 2^24, so a product that is
    not half-way between two steps is 2^-51 of its size away from there, more than the division
    errs; one that is half-way stays there where 1/lsb errs by less than half a last place.
    """
    if not codec.lsb:
        return 0
    steps = 1 / Fraction(repr(codec.lsb))
    whole = steps.denominator == 1 and steps < 1 << 27
    exact = abs(Fraction(codec.lsb) * steps - 1) < Fraction(1, 1 << 54)
    reach = max(-codec.raw_minimum, codec.raw_maximum)
    return int(steps) if whole and exact and reach < (1 << 23) * steps else 0
