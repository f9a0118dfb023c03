"""The law in C against the law in Python: any memory, any inputs, every bit of the state.

Steps and resets on random memory, as orders for `support/trial.c`, and in Python. If speed blends
the designs, a change of speed precedes each step and reset.

Programs run the law on random memory, and a controller node on random frames.
"""

import math
import random
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import can
import numpy as np
import numpy.typing as npt

from can_rig.errors import ExportError
from can_rig.export.boards import COUNT, LONGEST_S, RESTART, SURVIVE, frame_order, order, time_order
from can_rig.export.law import parts_of, support
from can_rig.export.network_code import frame_bytes
from can_rig.frames.codec import Transmitter
from can_rig.frames.network import Network, flagged
from can_rig.scenario.sensor_settings import SAMPLE_TICKS
from firmware_model.discretisation.tables import HYPOTHESES
from firmware_model.firmware import PYTHON_LAW, Law
from firmware_model.law.core.biquad import output
from firmware_model.law.layout import State, Table, precision_of
from firmware_model.law.monitor import COMPENSATION_OFF, SWINGING
from firmware_model.law.schedule import MAX_SPEEDS, Constants, State as BlendState
from firmware_model.law.status import FaultState, Verdict
from firmware_model.law.structs import (
    MAX_LATENCY_TICKS,
    MAX_SECTIONS,
    FloatArray,
    Of,
    Precision,
    Records,
    zeroed,
)
from firmware_model.law.supervision.covariance import LOSS_STATES
from firmware_model.law.supervision.echoes import FORCE, KEPT_TICKS, TORQUE, missing_command
from firmware_model.law.supervision.signatures import (
    FORCE_ECHO_ROW,
    FORCE_ROW,
    OFFSET_ROW,
    ROWS,
    TORQUE_ECHO_ROW,
)
from firmware_model.law.supervision.verdict import FORCE_LOST, TORQUE_OFFSET
from firmware_model.law.supervision.whitener import WHITENER_SECTIONS

HOST_FLAGS: Final = ("-std=c99", "-ffp-contract=off")

NODE_TICKS = 60
VALUES = (-2.0, 2.0)
SPEEDS = (-5.0, 50.0)  # m/s: within the designs' range and outside
STANDSTILLS = 0.01  # of all ticks
INDICES = (
    ("estimator.queue_1", "index"), ("estimator.queue_2", "index"),
    ("supervision.echoes", "index"), ("supervision.witness", "index"),
    ("supervision.mismatch.covariance", "first"),
)  # fmt: skip
SUMS = {
    "hypotheses.health": ("off", "faults"),
    "witness": ("age", "power", "apart", "inner", "sensor_off", "sensor_healthy_off", "witness_off",
                "healthy_off"),
    "echoes.actuators.0": ("missing", "off", "power", "stray", "swing"),
    "echoes.actuators.1": ("missing", "off", "power", "stray", "swing"),
    "hypotheses.signatures": ("commanded", "missing", "before", "jump"),
    **{f"hypotheses.signatures.rows.{row}.candidate":
       ("evidence", "correlation", "information", "age")
       for row in (FORCE_ECHO_ROW, TORQUE_ECHO_ROW, FORCE_ROW, OFFSET_ROW)},
    "hypotheses.frozen": ("repetitions",),
    "sequential_test.candidate": ("predicted", "correlation", "information", "age"),
}  # fmt: skip
"""Sums of a state that are compared with one another, and are seldom negative in a drive."""
LAST_TICKS = 65530  # the 16 bits of the tick end soon


def random_frames(network: Network, seed: int) -> list[list[can.Message]]:
    """By tick, what the plant node might have sent, the same for the same ``seed``."""
    choose, ticks = random.Random(seed), []
    transmitters = [Transmitter(codec) for codec in (*network.witnesses, *network.inputs)]
    first = choose.choice([0, LAST_TICKS])
    for tick in range(first, first + NODE_TICKS):
        frames: list[can.Message] = []
        for transmitter in transmitters:
            if choose.random() < 0.03:  # lose a few frames in a row
                for _ in range(choose.randrange(1, 9)):
                    transmitter.frame(0.0, tick)
            size = choose.choice([1.0, 1.0, 1.0, 1.0, 1e3, math.inf, math.nan])
            ends = SPEEDS if transmitter.codec is network.speed else VALUES
            says: tuple[bool, int, int] | tuple[()] = ()
            if transmitter.codec in network.witnesses:  # its validity, and the tick of its sample
                says = (choose.random() < 0.9, 0, (tick - choose.randrange(9)) % SAMPLE_TICKS)
            message = transmitter.frame(size * choose.uniform(*ends), tick, *says)
            what = choose.random()
            if what < 0.04:
                continue
            if what < 0.08:
                message.data[choose.randrange(len(message.data))] ^= 1 << choose.randrange(8)
            if what > 0.97:
                message.data = message.data[: choose.randrange(len(message.data))]
            frames += [message] * choose.choice([1, 1, 1, 1, 2])
            if what > 0.9:
                frames.append(can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b"\x01"))
        ticks.append(frames)
    return ticks


def as_orders(network: Network, seeds: range, tick_us: int) -> bytes:
    """Random frames with clock times, as orders of `support/bench.h`.

    Each seed has its own start time.

    The clock wraps; the node reads the clock before and after half a tick, and sometimes seems to
    have stood still.
    """
    orders, room = [], frame_bytes(network)
    for seed in seeds:
        choose, at_us = random.Random(seed), 2**32 - NODE_TICKS // 2 * tick_us
        orders.append(order(SURVIVE if seed % 2 else RESTART, room))
        for frames in random_frames(network, seed):
            late_us = choose.choice([0, choose.randrange(-tick_us // 20, tick_us // 20)])
            orders.append(time_order(at_us + late_us, room))
            for message in frames:
                number = flagged(message.arbitration_id, message.is_extended_id, message.is_fd)
                orders.append(frame_order(number, bytes(message.data), room))
            orders += [time_order(at_us + tick_us * tenth // 10, room) for tenth in (4, 5, 6)]
            at_us += tick_us
            if choose.random() < STANDSTILLS:
                most = 16 * tick_us  # ECU_MOST_LATE_TICKS
                stood = choose.choice([most, most + 1, 2 * most, 2**31, 2**32 - 2 * tick_us - 1])
                orders.append(time_order((at_us + late_us + stood) % 2**32, room))
        orders.append(order(COUNT, room))
    return b"".join(orders)


def trial_files(law: Mapping[str, str]) -> dict[str, str]:
    """The files of the law, and the trial that runs the law on any memory.

    The caller adds ``main``.

    Args:
        law: text by file name; `schedule.c` enables changes of speed.
    """
    return {**law, **{name: support(name, parts_of(law)) for name in ("bench.h", "trial.c")}}


def on_host(program: Path, orders: bytes, longest_s: float = LONGEST_S) -> bytes:
    """The program's answers.

    Raises:
        ExportError: the program fails, or ignores orders; the message has the first line of its
            output.
    """
    try:
        done = subprocess.run(
            [program],
            input=orders,
            capture_output=True,
            check=False,
            timeout=longest_s,
            cwd=program.parent,
        )
    except subprocess.TimeoutExpired:
        raise ExportError(f"the trial did not end within {longest_s:g} s") from None
    if done.returncode or done.stderr:
        lines = done.stderr.decode(errors="replace").splitlines() or [f"{done.returncode}"]
        said = next((line for line in lines if "error" in line.lower()), lines[0])
        raise ExportError(f"the trial ended: {said}")
    return done.stdout


SHARES = [0.0, 0.0, 0.02, 0.3]  # of special values
TICKS = (0, 0, 1, 2, 7, MAX_LATENCY_TICKS)


def reals(
    random: np.random.Generator,
    shape: tuple[int, ...],
    precision: Precision,
    even: bool = False,
    share: Any = None,
) -> Any:
    """Mostly ordinary magnitudes, mixed with all special values; ``even``: values repeat."""
    if even:
        return random.choice([-1.0, -0.0, 0.0, 0.5, 1.0, 2.0], shape).astype(precision)
    limits = np.finfo(precision)
    ordinary = random.standard_normal(shape) * 10.0 ** random.uniform(-3, 3, shape)
    kinds: list[float] = [0.0, -0.0, np.inf, -np.inf, np.nan, 1.0, -1.0]
    for each in (limits.max, -limits.max, limits.tiny, limits.smallest_subnormal):
        kinds.append(float(each))
    odd = random.choice(kinds, shape)
    share = random.choice(SHARES) if share is None else share
    with np.errstate(over="ignore"):
        return np.where(random.random(shape) < share, odd, ordinary).astype(precision)


def fill(
    random: np.random.Generator, records: Records[Any], precision: Precision, even: bool
) -> None:
    """Randomise every real number of ``records``, shape (1,); some fields get special values."""
    spots, counts = _reals_of(records.dtype, precision)
    shares = np.repeat(random.choice(SHARES, len(counts)), counts)
    shares *= random.random() < 0.3
    records.view(precision)[spots] = reals(random, spots.shape, precision, even, shares)


@cache
def _reals_of(
    dtype: np.dtype[Any], precision: Precision
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Place of each real number among those of this precision; how many each field has."""
    begins, counts = np.array(_real_fields(dtype)).T
    firsts = begins // np.dtype(precision).itemsize
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.repeat(firsts, counts) + within, counts


def _real_fields(dtype: np.dtype[Any], begin: int = 0) -> tuple[tuple[int, int], ...]:
    """Offset and length of each field of real numbers."""
    if dtype.base.names is None:
        return ((begin, math.prod(dtype.shape)),) if dtype.base.kind == "f" else ()
    if dtype.names is None:  # an array of structs
        begins = [begin + i * dtype.base.itemsize for i in range(math.prod(dtype.shape))]
        return tuple(each for at in begins for each in _real_fields(dtype.base, at))
    parts = (dtype.fields[name][:2] for name in dtype.names) if dtype.fields else ()
    return tuple(each for kind, offset in parts for each in _real_fields(kind, begin + offset))


def random_table(
    random: np.random.Generator, precision: Precision, even: bool = False
) -> Records[Table]:
    """A table, shape (1,), with valid counts and indices, and some plausible numbers."""
    tables = zeroed(Table, precision)
    table: Any = tables[0]  # random numbers, of NumPy's types
    fill(random, tables, precision, even)
    make_plausible(random, table, even)
    table.prediction.enabled = random.integers(0, 2)
    table.prediction.longest = random.choice([0.0, 2.0, 50.0])
    cars = table.other_cars
    for filter in (
        table.tracking.filter, table.estimator.channel_1, table.estimator.channel_2,
        table.estimator.one_plus_q, table.compensator.filter, *(
            channel for car in cars.cars
            for channel in (car.channel_1, car.channel_2)
        ),
    ):  # fmt: skip
        filter.n = random.integers(0, MAX_SECTIONS + 1) if random.random() < 0.3 else 2
        filter.coefficients[:, 3:] *= random.choice([1.0, 0.01])
    for filter in (  # filters of an unstable plant
        table.estimator.measurement, table.tracking.stabiliser, *(
            car.measurement for car in cars.cars
        ),
    ):  # fmt: skip
        filter.n = random.choice([0, 0, 1, 2])
    estimator = table.estimator
    estimator.latency_ticks, *dead_ticks_of_each = random.choice(TICKS, 3)
    estimator.shown_ticks_1, estimator.shown_ticks_2 = (
        estimator.latency_ticks + ticks for ticks in dead_ticks_of_each
    )
    cars.n = random.integers(0, 5)
    table.hypotheses.signatures.n = random.choice([TORQUE_ECHO_ROW, ROWS])
    for row, kind in zip(table.hypotheses.signatures.rows, HYPOTHESES, strict=True):
        any_kind = random.integers((1, 0, 0, 0), (8, 3, 4, 2))
        of = any_kind if random.random() < 0.1 else kind
        row.fault, row.through, row.input, row.echo = of
    table.mismatch.whitener.n = random.integers(0, WHITENER_SECTIONS + 1)
    table.mismatch.n = 0 if random.random() < 0.1 else cars.n + 3
    table.reference_shaper.enabled = random.integers(0, 2)
    table.compensator.on_confirmation = random.integers(0, 2)
    table.supervised = int(random.random() < 0.9)
    table.bumpless_transfer.slowest_pace = random.exponential()
    takeover = table.takeover
    takeover.enabled = random.integers(0, 2)
    takeover.listening, takeover.returning, takeover.lasting = np.sort(random.integers(1, 30, 3))
    echoes = table.echoes
    echoes.longest, echoes.working = random.choice([0, 1, 5, 100]), random.integers(0, 5)
    for actuator, dead_ticks in zip(echoes.actuators, dead_ticks_of_each, strict=True):
        actuator.stage.n = 1
        actuator.dead_ticks = random.integers(0, dead_ticks + 1)
    witness = table.witness
    witness.longest, witness.working = random.choice([0, 5, 100]), random.integers(1, 5)
    witness.lateral_weight, witness.late = random.random(), random.choice([0.0, 0.4, 3.0])
    if witness.longest == 100 and witness.working == 1:  # later than what the rings keep
        witness.late = 2.0 * KEPT_TICKS
    witness.makes = int(witness.working == 2)
    monitor = table.monitor
    monitor.enabled = random.random() < 0.4
    monitor.most_swings, monitor.patience = random.integers(1, 4, 2)
    if random.random() < 0.8:  # commands within reach
        monitor.limit_1 = monitor.limit_2 = monitor.slew_1 = monitor.slew_2 = np.inf
        monitor.lag, monitor.forgetting, monitor.swing, monitor.astray = random.random(4)
    return tables


def make_plausible(random: np.random.Generator, table: Any, even: bool) -> None:
    """Limits and thresholds that random numbers reach, in most tables."""
    if random.random() < 0.8:  # plausible limits
        for actuator in (table.actuator_1, table.actuator_2):
            actuator.limit, actuator.slew = abs(actuator.limit), abs(actuator.slew)
            actuator.lsb = random.choice([0.0, 1e-3])
    if random.random() < 0.8 and not even:  # thresholds within reach
        table.decision.suspect, table.decision.confirm = np.sort(random.exponential(2.0, 2))
        table.decision.recover = table.decision.certain = random.exponential(3.0)
        table.decision.takeover = table.decision.suspect
        weighed = table.hypotheses.signatures.candidate
        weighed.longest = 10.0 * abs(weighed.lifetime)
        table.mismatch.noise = random.exponential(1.0)
        table.mismatch.white = random.exponential(1.0)
        test = table.sequential_test
        test.restart, test.promising, test.freshness = -1.0, random.exponential(), random.random()
        test.needed = random.exponential()
        test.share = random.choice([0.0, random.random(), test.share])
        hypotheses, witness, echoes = table.hypotheses, table.witness, table.echoes
        hypotheses.ahead, hypotheses.sensor_ahead, hypotheses.jump = random.exponential(1.0, 3)
        hypotheses.both_lost = random.exponential()
        hypotheses.health.keep, hypotheses.health.nearer = 0.5, 81.0
        witness.noise, witness.doubt, witness.nearer, witness.keep = random.exponential(0.5, 4)
        for size in (
            echoes.wrong, hypotheses.torque_lost,
            *(row.limits for row in hypotheses.signatures.rows),
        ):  # fmt: skip
            size.least, size.most = np.sort(random.standard_normal(2))
        for actuator in echoes.actuators:
            actuator.least, actuator.lead = random.exponential(0.1), random.standard_normal()


def random_state(
    random: np.random.Generator, table: Any, precision: Precision, even: bool = False
) -> Records[State]:
    """A state for ``table``, shape (1,); of a few an index lies outside its array."""
    states = zeroed(State, precision)
    state: Any = states[0]
    own = state.supervision
    fill(random, states, precision, even)
    constants, estimator = table.estimator, state.estimator
    for name, ticks in (("queue_1", constants.shown_ticks_1), ("queue_2", constants.shown_ticks_2)):
        estimator[name].index = random.integers(0, max(ticks, 1))
    if random.random() < 0.5:  # a candidate near its age limit
        test, torque = own.sequential_test, own.sequential_test.candidate
        test.half_age, torque.predicted = random.integers(2, 9), random.exponential()
        torque.age = 2.0 * test.half_age + random.integers(-2, 3)
        test.half_information, torque.information = np.sort(random.exponential(1.0, 2))
        if random.random() < 0.4:  # without evidence
            test.delay[:], torque.explained[:] = 0.0, 0.0
    if random.random() < 0.3:
        own.bumpless_transfer.carried_speed = random.choice([np.inf, np.nan])
    if random.random() < 0.7 and not even:
        for where, names in SUMS.items():
            for name in names:
                size = random.exponential() * 10.0 ** random.uniform(-2.0, 2.0)
                setattr(part_of(own, where), name, size)
    state.mode = random.integers(0, 4)
    state.fault_state = random.choice([*FaultState, FaultState.CONFIRMED])
    saved, signatures = own.saved, own.hypotheses.signatures
    saved.fingerprint, signatures.obeyed = int(random.random() < 0.2), random.integers(0, 2)
    saved.fault_state, saved.verdict = random.integers(0, 4), random.integers(0, len(Verdict))
    own.standby.slow = int(random.random() < 0.05)
    for of in (own.standby, own.prediction):
        of.elapsed = random.choice([0.0, 1.0, 60.0, of.elapsed], p=[0.85, 0.05, 0.05, 0.05])
    own.echoes.index = random.integers(0, KEPT_TICKS)
    for echo in own.echoes.actuators:
        echo.left, echo.believed, echo.good = reported(random)
        echo.doubted, echo.lied = random.choice([(0, 1), (1, 0)])
        if random.random() < 0.3:  # of a motor that obeys, with a small or a large error
            with np.errstate(over="ignore"):
                echo.swing = random.choice([1e-2, 1.0]) * echo.error**2
            echo.stray = random.uniform(-1.0, 1.0) * echo.swing
            own.sequential_test.candidate.predicted = random.exponential(100.0)
        if random.random() < 0.2:  # of a motor that has lost a share
            share = random.uniform(0.0, 3.0)
            echo.turned, echo.swing = 0.0, random.choice([0.0, abs(echo.swing)])
            with np.errstate(over="ignore"):
                echo.error = echo.modelled * share
                echo.stray = echo.swing * share * random.uniform(0.5, 1.5)
    fill_witness(random, table, own)
    own.hypotheses.verdict = random.choice([TORQUE_OFFSET, FORCE_LOST] * 4 + [*Verdict])
    state.monitor.reason = random.choice([0, 0, 0, 0, COMPENSATION_OFF, SWINGING])
    own.takeover.pending = random.choice([0, 0, 0, 0, 1, 2])
    own.takeover.active, own.takeover.elapsed = random.integers(0, 2), random.integers(0, 9)
    own.mismatch.covariance.first = random.choice([0, LOSS_STATES])
    own.mismatch.covariance.variances[:] = abs(own.mismatch.covariance.variances)
    if random.random() < 0.1:
        where, index = random.choice(INDICES)
        part_of(state, where)[index] = random.choice([-1, 2**7, 2**30, -(2**31)])
    return states


def reported(random: np.random.Generator) -> Any:
    """How long a report counts, whether a fault is believed, and good reports: of an echo."""
    return (random.random(3) < [0.8, 0.4, 0.3]) * [random.choice([1, 9]), 1, 4]


def fill_witness(random: np.random.Generator, table: Any, own: Any) -> None:
    """What the witness knows, which often agrees with the sensor or with an echo."""
    witness = own.witness
    witness.index = random.integers(0, KEPT_TICKS)
    witness.left, witness.denied, witness.good = reported(random)
    if random.random() < 0.4:  # agrees with itself and with the sensor, not with the model
        witness.apart, witness.inner = 1e-2 * witness.apart, 1e-4 * witness.inner
        own.echoes.actuators[TORQUE].missing *= 0.1
        own.echoes.actuators[FORCE].off *= 0.01
    if random.random() < 0.4:  # about as far off as the lost torque that its echo reports
        actuator, echo = table.echoes.actuators[TORQUE], own.echoes.actuators[TORQUE]
        answer = own.hypotheses.signatures.rows[TORQUE_ECHO_ROW].answer
        missing = missing_command(actuator, echo)
        shown = output(table.estimator.channel_1, answer, missing)
        with np.errstate(over="ignore"):
            echo.power = 0.5 * echo.missing + 9.0 * actuator.least
            witness.difference = -shown * random.uniform(0.5, 1.5)
    witness.measured[random.random(KEPT_TICKS) < 0.1] = np.nan
    for sample in (witness.yaw_rate, witness.acceleration):
        sample.fresh, sample.age = random.random() < 0.7, random.choice([*range(9), 200.0, np.nan])


def part_of(record: Any, where: str) -> Any:
    """The record at a path of names with dots."""
    for name in where.split("."):
        record = record[int(name)] if name.isdigit() else getattr(record, name)
    return record


SLOWEST, FASTEST = 1.0, 100.0  # m/s


@dataclass(frozen=True)
class Drive:
    """The blending of a table, and the speed before each tick.

    Attributes:
        schedules: the designs, shape (1,).
        blendings: the state of the blending before the first tick, shape (1,).
        speeds: shape (ticks,).
    """

    schedules: Records[Constants]
    blendings: Records[BlendState]
    speeds: FloatArray


def random_drive(
    random: np.random.Generator, precision: Precision, ticks: int, even: bool = False
) -> Drive:
    """For a random table; ``even``: many numbers are equal."""
    schedules = zeroed(Constants, precision)
    schedule: Constants = schedules[0]
    fill(random, schedules, precision, even)
    n = schedule.n = random.choice([1, 2, MAX_SPEEDS, *random.integers(1, MAX_SPEEDS + 1, 3)])
    schedule.speed[:] = np.sort(random.uniform(SLOWEST, FASTEST, MAX_SPEEDS))
    if random.random() < 0.8:  # turns that leave numbers of ordinary size
        for name in schedules.dtype.names or ():
            if "turn" in name:
                schedules[name] = np.clip(np.nan_to_num(schedules[name]), -2.0, 2.0)
    blendings = zeroed(BlendState, precision)
    fill(random, blendings, precision, even)
    blendings["place"] = random.choice([0.0, random.uniform(0.0, n - 1.0), n - 1.0])
    limits = np.finfo(precision)
    odd: list[float] = [np.nan, np.inf, -np.inf, 0.0, -1.0]
    odd += [float(limits.max), float(limits.smallest_subnormal)]
    at_designs = random.choice(schedule.speed[:n], ticks)
    between = random.uniform(0.5 * SLOWEST, 1.2 * FASTEST, ticks)
    kinds = random.choice(3, ticks, p=[0.6, 0.25, 0.15])
    speeds = np.choose(kinds, [between, at_designs, random.choice(odd, ticks)]).astype(precision)
    again = random.random(ticks) < 0.1  # the speed of the tick before
    again[0] = False
    speeds[again] = speeds[np.flatnonzero(again) - 1]
    return Drive(schedules, blendings, speeds)


@dataclass(frozen=True)
class Trial:
    """One memory with its inputs.

    Attributes:
        tables: the constant table, shape (1,).
        states: the state before the first tick, shape (1,).
        inputs: reference and measurement of each tick, shape (ticks, 2); the tick in the middle is
            a reset to its reference.
        samples: sensor, value and age of a sample before each tick, shape (ticks, 3).
        drive: blends the table before each tick; None: no blending.
    """

    tables: Records[Table]
    states: Records[State]
    inputs: FloatArray
    samples: FloatArray
    drive: Drive | None = None

    @property
    def answers(self) -> int:
        """Number of answers."""
        return len(self.inputs) * (1 if self.drive is None else 2) + 1


def random_trials(
    precision: Precision, seed: int, memories: int, ticks: int, blends: bool = False
) -> list[Trial]:
    """Trials of any memory and any inputs, the same for the same ``seed``."""
    random, trials = np.random.default_rng(seed), []
    for _ in range(memories):
        even = random.random() < 0.2  # equal operands for comparisons
        tables = random_table(random, precision, even)
        states = random_state(random, tables[0], precision, even)
        inputs = reals(random, (ticks, 2), precision, even)
        again = 1 + np.flatnonzero(random.random(ticks - 1) < 0.2)
        inputs[again] = inputs[again - 1]
        for of in (
            states[0],
            states[0].supervision.hypotheses.frozen,
        ):  # a measurement that repeats
            if random.random() < 0.2:
                of.measurement = inputs[0, 1]
        drive = random_drive(random, precision, ticks, even) if blends else None
        samples = reals(random, (ticks, 3), precision, even)
        samples[:, 0] = random.choice([1.0, 2.0, 3.0, 3.0, 4.0, 4.0, 0.0], ticks)
        samples[random.random(ticks) < 0.02, 1] = np.finfo(precision).max
        samples[:, 2] = random.choice([*range(KEPT_TICKS + 1), -1.0, np.nan], ticks)
        trials.append(Trial(tables, states, inputs, samples, drive))
    return trials


def encoded(trials: list[Trial]) -> bytes:
    """The trials as orders; each change of the speed and each tick is answered by a state."""
    orders = []
    for trial in trials:
        orders += [b"M", trial.tables.tobytes(), trial.states.tobytes()]
        drive = trial.drive
        if drive is not None:
            orders += [b"B", drive.schedules.tobytes(), drive.blendings.tobytes()]
        for k, inputs in enumerate(trial.inputs):
            if drive is not None:
                orders.append(b"V" + drive.speeds[k].tobytes())
            orders.append(b"E" + trial.samples[k].tobytes())
            is_reset = k == len(trial.inputs) // 2
            orders.append(b"Z" + inputs[:1].tobytes() if is_reset else b"S" + inputs.tobytes())
        orders.append(b"I")
    return b"".join(orders)


def states_of(law: Law, trials: list[Trial]) -> Iterator[bytes]:
    """The law's answers to the trials: each state, followed by the blended table, if any."""
    for trial in trials:
        tables, states = exactly(trial.tables), exactly(trial.states)
        kept: list[Records[Any]] = [states]
        change_speed = None
        if trial.drive is not None:
            schedules, blendings = trial.drive.schedules, exactly(trial.drive.blendings)
            kept += [tables, blendings]
            change_speed = law.change_speed_of((schedules, blendings, tables, states))
        step, hear = law.step_of(tables, states), law.hear_of(tables, states)
        for k, (reference, measurement) in enumerate(trial.inputs.astype(float)):
            if change_speed is not None and trial.drive is not None:
                change_speed(float(trial.drive.speeds[k]))
                yield b"".join(each.tobytes() for each in kept)
            hear(*trial.samples[k].astype(float).tolist())
            if k == len(trial.inputs) // 2:
                law.reset(tables[0], states[0], reference)
            else:
                step(reference, measurement)
            yield b"".join(each.tobytes() for each in kept)
        started = law.init(tables[0]).tobytes()
        yield started + b"".join(each.tobytes() for each in kept[1:])


def exactly(memory: Records[Of]) -> Records[Of]:
    """A copy that includes the padding between fields."""
    copy = memory.copy()
    copy.view(np.uint8)[:] = memory.view(np.uint8)
    return copy


def in_python(trials: list[Trial]) -> bytes:
    """The answers of the law in Python."""
    return b"".join(states_of(PYTHON_LAW, trials))


def different(one: bytes, other: bytes, trials: list[Trial]) -> int:
    """Number of states (with blended tables) that differ in a bit between two rows of answers.

    All not-a-numbers count as equal: their bits depend on the processor.
    """
    first = trials[0]
    blended = () if first.drive is None else (first.tables, first.drive.blendings)
    size = sum(each.itemsize for each in (first.states, *blended))
    dtype = precision_of(first.tables[0])
    expected = sum(trial.answers for trial in trials)
    if len(one) != expected * size or len(other) != expected * size:
        return expected
    same = [comparable(each, dtype).view(np.uint8).reshape(expected, size) for each in (one, other)]
    return int(np.count_nonzero((same[0] != same[1]).any(axis=1)))


def comparable(answers: bytes, precision: Precision) -> FloatArray:
    """The numbers of ``answers``, in which all not-a-numbers are alike."""
    numbers = np.frombuffer(answers, precision).copy()
    numbers[np.isnan(numbers)] = np.nan
    return numbers
