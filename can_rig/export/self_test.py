"""The known answers of an exported controller: stored ticks, and CRCs of what Python answers.

`support/self_test.c` compares.
"""

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np

from can_rig.export.c_files import comment, name, number
from firmware_model.discretisation.schedules import Scheduled
from firmware_model.firmware import PYTHON_LAW, fingerprint
from firmware_model.law.core.biquad import advance, at_rest, output
from firmware_model.law.layout import State, Table, precision_of
from firmware_model.law.schedule import Constants, State as Blending
from firmware_model.law.status import FaultState, Mode, Verdict
from firmware_model.law.structs import (
    FloatArray,
    Precision,
    Records,
    Struct,
    as_bytes,
    copied,
    leaves,
    record_type,
    values,
    zeroed,
)
from firmware_model.law.supervision.takeover import UNKNOWN

DATA: Final = "self_test_data.c"
MEMORY: Final = "firmware_memory"

TICKS: Final = 440
SINE_TICKS: Final = 150  # a period of the reference
FASTER: Final = (300, 330)  # from a design's speed to the next
LOST: Final = range(120, 300)  # command 1 does not reach the plant
UNMEASURED: Final = range(220, 235)
UNTOLD: Final = range(240, 245)
SATURATED: Final = range(300, 330)  # a reference beyond all limits
RESTARTED: Final = 330  # as after power-up, while the plant moves
SLOW: Final = range(360, 370)  # below the speed of the lowest design
RESET: Final = 390
SWINGING: Final = range(395, TICKS)  # the measurement, from side to side
SWING_TICKS: Final = 6
SAMPLED_TICKS: Final = 5  # from sample to sample of a further sensor
STARTS: Final = (0, RESTARTED, RESET, TICKS)
HUGE: Final = 1e3


@dataclass(frozen=True)
class KnownAnswers:
    """Stored ticks and Python's answers.

    Attributes:
        inputs: reference and measurement of each tick, and the speed of the car for designs blended
            by the speed; shape (``TICKS``, 2 or 3), in the precision of the law.
        crc: CRC-32 of all answers and states.
        seen: the modes, fault states and verdicts among the answers.
    """

    inputs: FloatArray
    crc: int
    seen: tuple[str, ...]


class _Plant:
    """The plant that the estimator believes in, at the bus of the scenario.

    An unstable plant is N1 and N2 over M; the M of a stable plant has no section.

    Args:
        table: of the controller, at any moment.
    """

    def __init__(self, table: Table) -> None:
        self._of = table.estimator
        self._states = [at_rest(precision_of(table)) for _ in range(3)]
        late = (self._of.shown_ticks_1, self._of.shown_ticks_2)
        self._under_way = [[0.0] * max(int(ticks), 1) for ticks in late]

    def measurement(self) -> float:
        """The measurement of the next tick."""
        of, (one, two, measured) = self._of, self._states
        y = advance(of.channel_1, one, self._under_way[0].pop(0))
        y += advance(of.channel_2, two, self._under_way[1].pop(0))
        past = output(of.measurement, measured, 0.0)
        y = (y - past) / (output(of.measurement, measured, 1.0) - past)
        advance(of.measurement, measured, y)
        return y

    def act(self, command_1: float, command_2: float) -> None:
        """The commands of a tick."""
        self._under_way[0].append(command_1)
        self._under_way[1].append(command_2)


def known_answers(of: Scheduled, amplitude: float, hears: bool = False) -> KnownAnswers:
    """A healthy plant, a loss of channel 1, missing inputs, saturation, a restart, a reset, swings.

    Args:
        of: table and schedule of the controller.
        amplitude: of the reference, in the measurement's unit.
        hears: whether the controller hears ``_samples``.
    """
    precision = precision_of(of.table)
    tables, blendings = copied(of.table), zeroed(Blending, precision)
    states = PYTHON_LAW.init(of.table)
    step, plant = PYTHON_LAW.step_of(tables, states), _Plant(tables[0])
    change_speed, speeds = None, np.empty((TICKS, 0))
    memory: list[tuple[type[Struct], Records[Any]]] = [(State, states)]
    if of.schedule is not None:
        schedules = copied(of.schedule)
        change_speed = PYTHON_LAW.change_speed_of((schedules, blendings, tables, states))
        speeds = _speeds(of.schedule)
        memory += [(Table, tables), (Blending, blendings)]
    inputs = np.column_stack([np.zeros((TICKS, 2)), speeds]).astype(precision)
    said, seen, commands = b"", set[str](), (0.0, 0.0)
    hear = PYTHON_LAW.hear_of(tables, states)
    for k, row in enumerate(inputs):
        row[:2] = _inputs(k, amplitude, plant.measurement())
        if k == RESET:
            PYTHON_LAW.reset(tables[0], states[0], float(row[0]))
        elif k in STARTS:
            tables[0], blendings[0] = of.table, np.zeros((), blendings.dtype)
            states[0] = PYTHON_LAW.init(of.table)[0]
            states[0].supervision.takeover.pending = UNKNOWN
        if change_speed is not None:
            change_speed(float(row[2]))
        if k in STARTS:
            begin, commands = k, (0.0, 0.0)
        if hears and (k - begin) % SAMPLED_TICKS == 0:
            for sample in _samples(*commands, float(row[1])):
                hear(*sample)
        *reals, mode, fault_state, verdict = step(float(row[0]), float(row[1]))
        commands = reals[0], reals[1]
        plant.act(0.0 if k in LOST else reals[0], reals[1])
        said += as_bytes(np.array(reals, precision))
        said += as_bytes(np.array([mode, fault_state, verdict], np.int32))
        codes = (Mode(mode), FaultState(fault_state), Verdict(verdict))
        seen |= {f"{type(each).__name__}.{each.name}" for each in codes}
        if k + 1 in STARTS:
            said += b"".join(values(struct, records[0]) for struct, records in memory)
    return KnownAnswers(inputs, zlib.crc32(said), tuple(sorted(seen)))


def _inputs(k: int, amplitude: float, measurement: float) -> tuple[float, float]:
    """Reference and measurement of tick ``k``."""
    reference = amplitude * math.sin(2.0 * math.pi * k / SINE_TICKS)
    if k in SATURATED:
        reference *= HUGE
    if k in SWINGING:
        measurement = 10.0 * amplitude * (-1.0) ** (k // SWING_TICKS)
    return math.nan if k in UNTOLD else reference, math.nan if k in UNMEASURED else measurement


def _samples(
    command_1: float, command_2: float, measurement: float
) -> Iterator[tuple[int, float, float]]:
    """Samples of further sensors: of numbers that ``self_test.c`` knows, exact in every precision.

    The commands are those of the tick before.
    """
    yield 1, command_1, 0.0
    yield 2, 0.5 * command_2, 1.0
    yield 3, 0.0625 * measurement, 2.0
    yield 4, measurement, 3.0


def _speeds(schedule: Constants) -> FloatArray:
    """The speed of each tick, shape (``TICKS``, 1)."""
    designs = schedule.speed[: schedule.n].astype(float)
    at = len(designs) // 2
    after = min(at + 1, len(designs) - 1)
    speeds: FloatArray = np.interp(np.arange(TICKS), FASTER, designs[[at, after]])
    speeds[SLOW] = 0.5 * designs[0]
    speeds[UNMEASURED] = math.nan
    return speeds.reshape(-1, 1)


# --- memory as bytes -----------------------------------------------------------------------------


def _spans(tag: str, memory: list[tuple[str, type[Struct]]], precision: Precision) -> Iterator[str]:
    """Initialisers for the numbers of a struct of C: reals without a gap share a span.

    Args:
        tag: of the struct in C.
        memory: its parts: how each path begins in C, and its declaration.
        precision: of its real numbers.
    """
    for begin, struct in memory:
        spans: list[tuple[str, int, bool]] = []
        end = -1
        for path, offset, kind in leaves(struct, record_type(struct, precision)):
            count, is_real = math.prod(kind.shape), kind.base.kind == "f"
            if spans and is_real and spans[-1][2] and offset == end:
                spans[-1] = (spans[-1][0], spans[-1][1] + count, True)
            else:
                spans.append((begin + _member(path), count, is_real))
            end = offset + kind.itemsize
        for place, count, is_real in spans:
            yield f"    {{offsetof(struct {tag}, {place}), {count}, {str(is_real).lower()}}},"
    yield "    {0, 0, false},"


def _member(path: tuple[str | int, ...]) -> str:
    """A path of Python as C writes the path."""
    steps = (f"[{each}]" if isinstance(each, int) else f".{name(each)}" for each in path)
    return "".join(steps).removeprefix(".")


def self_test_data(of: Scheduled, amplitude: float, hears: bool) -> str:
    """``self_test_data.c``; the arguments are those of ``known_answers``."""
    known, precision = known_answers(of, amplitude, hears), precision_of(of.table)
    constants = values(Table, of.table)
    memory: list[tuple[str, type[Struct]]] = [("", State)]
    tag = "layout_state"
    spans = {"table": _spans("layout_table", [("", Table)], precision)}
    if of.schedule is not None:
        constants += values(Constants, of.schedule)
        memory, tag = [("state.", State), ("table.", Table), ("blending.", Blending)], MEMORY
        spans["schedule"] = _spans("schedule_constants", [("", Constants)], precision)
    spans["memory"] = _spans(tag, memory, precision)
    lines = [
        *comment("What the control law in Python answers to stored ticks. Among the answers:"),
        *comment(f"{', '.join(known.seen)}."),
        '#include "self_test.h"', "", "#include <stddef.h>", "",
        "static const struct self_test_part parts[] = {",
        *(
            f"    {{{end - start}, {str(start == RESET).lower()}}},"
            for start, end in pairwise(STARTS)
        ),
        "    {0, false},", "};",
    ]  # fmt: skip
    for what, rows in spans.items():
        lines += ["", f"static const struct self_test_span {what}[] = {{", *rows, "};"]
    lines += ["", "static const struct self_test_tick ticks[] = {"]
    for row in known.inputs:
        lines.append(f"    {{{', '.join(number(float(each), precision) for each in row)}}},")
    lines += ["};", "", "const struct self_test_data self_test_data = {"]
    lines += [f"    .{each} = {each}," for each in ("ticks", "parts", *spans)]
    version = fingerprint(of.table, of.schedule) % (1 << 32)
    guarded = constants + version.to_bytes(4, "little")
    lines += [f"    .crc_of_constants = 0x{zlib.crc32(guarded):08X}u, /* and of the next */"]
    lines += [f"    .fingerprint = 0x{version:08X}u,"]
    lines += [f"    .crc_of_answers = 0x{known.crc:08X}u,", "};"]
    return "\n".join(lines) + "\n"
