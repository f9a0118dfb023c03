"""A recorded drive through the firmware: d̂ of a car that another controller, or a driver, steered.

F1 and the decision work on the inputs that the log has:

| the log has                       | F1 works on it               | model of the actuator |
|-----------------------------------|------------------------------|-----------------------|
| ``torque``, ``force_difference``  | as measured at the actuator  | left out              |
| ``command_1``, ``command_2``      | as sent to the actuator      | as in the scenario    |
| neither, of the force difference  | 0 N: there is no actuator    | as in the scenario    |

The controller computes its own commands, and no command acts on the car. Without ``reference``
in the log, the reference is D* itself: then the torque command follows the torque that would make
the model move as the car did.

Where the log has the speed, the design follows the speed. Below the lowest design the
controller is in STANDBY.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from cantools.database.conversion import BaseConversion
from numpy.typing import NDArray

from can_rig.decoding.files import Contents, output
from can_rig.decoding.message_decoder import MessageColumns, SignalColumn, byte_column
from can_rig.errors import LogError, ScenarioError
from can_rig.logs.frames import NS_PER_S
from can_rig.replaying.recorded_drive import Buses, Drive, recorded_drive
from can_rig.results.source import Reading, Source
from can_rig.scenario.build import require_ours
from can_rig.scenario.controls import controls
from can_rig.scenario.driving import design_speeds
from can_rig.scenario.log_signals import MPS2, NM, ROLES, N
from can_rig.scenario.settings import (
    FASTEST_MPS,
    SLOWEST_DESIGN_MPS,
    DriveSettings,
    NetworkSettings,
    Scenario,
)
from can_rig.storage.files import PICTURES, atomic, refuse_existing
from firmware_model.firmware import Firmware
from firmware_model.law.status import FaultState, Mode, Verdict
from firmware_model.law.structs import FloatArray

SLOWEST_SHARE: Final = 0.1
"""The lowest design speed is at least this share of the highest: a car that parks does not spread
the designs."""

TOO_RARE: Final = 1.5
"""Ticks between two samples of D* from which on the decision may take a sensor for frozen."""

OPPOSITE: Final = -0.2
"""Correlation of two witnesses of one turn from which on down their signs are opposite."""

STEADY: Final = 1.02
"""Speeds within this ratio have one design."""

CODES: Final = {"mode": Mode, "fault_state": FaultState, "verdict": Verdict}

COLUMNS: Final = {
    "reference_mps2": MPS2,
    "dstar_mps2": MPS2,
    "torque_nm": NM,
    "force_difference_n": N,
    "fault_estimate_mps2": MPS2,
}
"""The columns of every replay and their units, beside ``CODES`` and the inputs."""

INPUTS: Final = {
    "yaw_rate": "yaw_rate_rad_per_s",
    "lateral_acceleration": "lateral_acceleration_mps2",
    "speed": "speed_mps",
    "torque": "measured_torque_nm",
    "force_difference": "measured_force_difference_n",
    "command_1": "logged_torque_nm",
    "command_2": "logged_force_difference_n",
}
"""The column of each role that the log has."""


@dataclass(frozen=True)
class Replayed:
    """What the firmware made of a recorded drive.

    Attributes:
        scenario: as it was replayed.
        drive: the inputs, and the samples that they come from.
        columns: a row a tick; ``columns.layout`` has units and words.
        start_ns: the start of the recording.
        design_speeds_mps: the speeds of the designs; one for a constant speed.
    """

    scenario: Scenario
    drive: Drive
    columns: MessageColumns
    start_ns: int
    design_speeds_mps: tuple[float, ...]

    @property
    def time_s(self) -> FloatArray:
        """(ticks,) since the start of the recording."""
        return (self.columns.time_ns - self.start_ns) / NS_PER_S

    def events(self) -> list[tuple[float, str, str]]:
        """Time [s], fault state and verdict of the first tick and of every change."""
        states, verdicts = self.columns.signals["fault_state"], self.columns.signals["verdict"]
        changed = (np.diff(states, prepend=-1) != 0) | (np.diff(verdicts, prepend=-1) != 0)
        return [
            (float(self.time_s[at]), FaultState(states[at]).name, Verdict(verdicts[at]).name)
            for at in np.flatnonzero(changed)
        ]

    def notes(self) -> list[str]:
        """Lines about samples too rare for the tick, and about witnesses that contradict."""
        has, said = self.drive.columns, []
        if {"yaw_rate", "lateral_acceleration", "speed"} <= has.keys():
            turned, felt = has["yaw_rate"] * has["speed"], has["lateral_acceleration"]
            both = np.isfinite(turned) & np.isfinite(felt)
            with np.errstate(invalid="ignore"):  # one that never changes
                alike = np.corrcoef(turned[both], felt[both])[0, 1] if both.any() else 1.0
            if alike < OPPOSITE:
                said.append(
                    f"yaw rate times speed and lateral acceleration have opposite signs "
                    f"(correlation {alike:.2f}): one of them must have factor = -1, as a sensor "
                    "with the other direction, or D* is wrong"
                )
        of_output = {"feedback", "yaw_rate", "lateral_acceleration"}
        periods = [each.period_s for each in self.drive.samples if each.role in of_output]
        if max(periods) <= TOO_RARE * self.scenario.tick_s:
            return said
        return [
            *said,
            f"D* has a new sample every {1e3 * max(periods):.3g} ms only, and the tick is "
            f"{1e3 * self.scenario.tick_s:g} ms: repeated samples look like a frozen sensor; "
            "choose a scenario with a longer tick",
        ]

    def summary(self) -> dict[str, Any]:
        """Ticks, signals, d̂ and events, for JSON; every number in the unit of its name."""
        mode = self.columns.signals["mode"]
        running = mode == Mode.RUN
        estimate = self.columns.signals["fault_estimate_mps2"][running]
        return {
            "scenario": self.scenario.name,
            "tick_s": self.scenario.tick_s,
            "ticks": len(self.columns),
            "ticks_run": int(running.sum()),
            "ticks_blind": int((mode == Mode.BLIND).sum()),
            "ticks_standby": int((mode == Mode.STANDBY).sum()),
            "from_s": float(self.time_s[0]),
            "to_s": float(self.time_s[-1]),
            "design_speeds_mps": list(self.design_speeds_mps),
            "fault_estimate_rms_mps2": _rms(estimate),
            "fault_estimate_peak_mps2": float(np.abs(estimate).max()) if len(estimate) else None,
            "dstar_rms_mps2": _rms(self.columns.signals["dstar_mps2"][running]),
            "rules": list(rules(self.drive)),
            "signals": [
                {
                    "role": each.role,
                    "signal": each.of.signal,
                    "bus": each.bus,
                    "unit": each.unit,
                    "samples": len(each.values),
                    "period_s": each.period_s,
                    "max_age_s": each.max_age_ns / NS_PER_S,
                    "gaps": len(each.gaps()),
                    "least": _or_none(np.nanmin, each.values),
                    "largest": _or_none(np.nanmax, each.values),
                    "unit_of_role": ROLES[each.role],
                }
                for each in self.drive.samples
            ],
            "events": [
                {"time_s": time_s, "fault_state": state, "verdict": verdict}
                for time_s, state, verdict in self.events()
            ],
        }


def rules(drive: Drive) -> Iterator[str]:
    """A line for each input: where it comes from."""
    has = drive.columns
    if "feedback" not in has:
        yield "D* is made of yaw rate, lateral acceleration and speed (3.8)"
    if "reference" not in has:
        yield "no reference in the log: the reference is D*"
    for name, measured, sent in (
        ("torque", "torque", "command_1"),
        ("force difference", "force_difference", "command_2"),
    ):
        if measured in has:
            yield f"{name} as measured: the model of its actuator is left out"
        elif sent in has:
            yield f"{name} as sent: the model of its actuator is the scenario's"
        else:
            yield f"no {name} in the log: 0"


def no_count(_ticks: int) -> AbstractContextManager[Callable[[int], None]]:
    """Show no progress."""
    return nullcontext(lambda _tick: None)


def replay_drive(
    source: Source,
    dbc: Buses = {},  # noqa: B006 (read only)
    max_age_s: float | None = None,
    reading: Reading = iter,
    counting: Callable[[int], AbstractContextManager[Callable[[int], None]]] = no_count,
) -> Replayed:
    """Run the firmware on a recorded drive.

    Args:
        source: the log and the scenario, whose ``network.signals`` name the log's signals.
        dbc: databases by bus; "" in place of ``network.dbc``.
        max_age_s: how long a sample holds; None: five periods of its signal.
        reading: iterates over the log and shows the progress.
        counting: of a number of ticks, shows the progress.

    Raises:
        LogError, DbcError, ScenarioError: see ``recorded_drive``; or the design fails.
    """
    if max_age_s is not None and not 0.0 < max_age_s < math.inf:
        raise LogError(f"max age = {max_age_s:g} s: must be above 0")
    require_ours(source.scenario, "a recorded drive through the estimator")
    drive = recorded_drive(source, dbc, max_age_s, reading)
    scenario = _scenario_of(source.scenario, drive)
    of = controls(scenario, None)
    speeds = design_speeds(scenario) if scenario.drive.is_given else (scenario.model.speed_mps,)
    y = drive.dstar_mps2(scenario.model.lateral_weight)
    u1 = drive.columns.get("torque", drive.columns.get("command_1"))
    assert u1 is not None
    none = np.zeros(len(y))
    u2 = drive.columns.get("force_difference", drive.columns.get("command_2", none))
    speed = drive.columns.get("speed", np.full(len(y), math.nan))
    reference = drive.columns.get("reference", y)
    known = np.isfinite(y) & np.isfinite(u1) & np.isfinite(u2) & np.isfinite(reference)
    moves = known & ~(speed < speeds[0] * (1.0 - 1e-9))
    if not moves.any():
        raise LogError(
            f"{source.log.path}: no tick has all of its inputs at a speed of {speeds[0]:.3g} m/s "
            "or above"
        )
    firmware = Firmware(of.table, speeds=of.schedule)
    answers = np.empty((len(y), 6))
    with counting(len(y)) as progress:
        first = int(np.argmax(moves))
        firmware.change_speed(float(speed[first]))
        firmware.step(math.nan, math.nan)
        firmware.reset(float(y[first]))
        acting = [0.0, 0.0]
        rows = zip(*(c.tolist() for c in (reference, y, u1, u2, speed, known)), strict=True)
        for tick, (r, measured, torque, force, v, usable) in enumerate(rows):
            for at, value in enumerate((torque, force)):
                if math.isfinite(value):
                    acting[at] = value
            firmware.drive_with(*acting)
            if math.isfinite(v):
                firmware.change_speed(v)
            answers[tick] = firmware.step(r, measured) if usable else firmware.step(*_NOTHING)
            if tick % _EVERY == 0:
                progress(tick)
    inputs = {INPUTS[role]: c for role, c in drive.columns.items() if role in INPUTS}
    columns = _columns(drive.time_ns, reference, y, answers, inputs)
    return Replayed(scenario, drive, columns, source.log.start_ns, speeds)


_NOTHING: Final = (math.nan, math.nan)
_EVERY: Final = 500


def _scenario_of(scenario: Scenario, drive: Drive) -> Scenario:
    """The scenario of the controller that can follow the drive."""
    model = scenario.model
    for role in ("torque", "force_difference"):
        if role in drive.columns:
            actuator = getattr(model, f"{role}_actuator")
            ideal = replace(actuator, lag_s=0.0, natural_frequency_rad_per_s=None, dead_time_s=0.0)
            model = replace(model, **{f"{role}_actuator": ideal})
    scenario = replace(
        scenario,
        model=model,
        fault=(),
        disturbance=(),
        network=NetworkSettings(),
        drive=ANY_SPEED if scenario.design.speeds_mps else DriveSettings(),
        latency_ticks=max(scenario.latency_ticks, 1),  # what acts is known a tick later
    )
    speed = drive.columns.get("speed")
    if speed is None or scenario.design.speeds_mps:
        return scenario
    highest = float(np.nanmax(speed))
    lowest = max(float(np.nanmin(speed)), SLOWEST_DESIGN_MPS, SLOWEST_SHARE * highest)
    if not SLOWEST_DESIGN_MPS <= highest <= FASTEST_MPS:
        raise ScenarioError(
            f"scenario {scenario.name}: network.signals.speed: reaches {highest:.4g} m/s: must be "
            f"{SLOWEST_DESIGN_MPS:g} to {FASTEST_MPS:g} m/s; unit or factor may be wrong"
        )
    if highest <= STEADY * lowest:
        middle = math.sqrt(highest * lowest)
        return replace(scenario, model=replace(model, speed_mps=middle))
    return replace(scenario, drive=_between(lowest, highest))


def _between(lowest_mps: float, highest_mps: float) -> DriveSettings:
    """A drive at all speeds of a range, for the designs."""
    return DriveSettings(ramps=((0.0, lowest_mps), (1000.0, highest_mps)))


ANY_SPEED: Final = _between(SLOWEST_DESIGN_MPS, FASTEST_MPS)


def _columns(
    time_ns: NDArray[np.int64],
    reference: FloatArray,
    y: FloatArray,
    answers: FloatArray,
    inputs: Mapping[str, FloatArray],
) -> MessageColumns:
    """The columns of a replay as those of one message."""
    command_1, command_2, estimate, *codes = answers.T
    signals: dict[str, Any] = dict(
        zip(COLUMNS, (reference, y, command_1, command_2, estimate), strict=True)
    )
    layout = {name: _column(name, unit) for name, unit in COLUMNS.items()}
    whole = {name: code.astype(np.int64) for name, code in zip(CODES, codes, strict=True)}
    for name, words in CODES.items():
        choices = {int(word): word.name for word in words}
        layout[name] = replace(byte_column(name), choices=choices)
    for role, name in INPUTS.items():
        if name in inputs:
            layout[name] = _column(name, ROLES[role])
    rows = np.arange(len(time_ns))
    return MessageColumns("replay", time_ns, rows, signals | whole | dict(inputs), whole, layout)


def _column(name: str, unit: str) -> SignalColumn:
    number = BaseConversion.factory(scale=1, offset=0, is_float=True)
    return SignalColumn(name, unit, 0, 64, False, True, True, number, {})


def _rms(values: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _or_none(of: Any, values: FloatArray) -> float | None:
    return float(of(values)) if np.isfinite(values).any() else None


def refuse_output(path: Path, force: bool) -> None:
    """Refuse an unknown format, or an existing output without ``force``.

    Raises:
        LogError: the reason.
    """
    if path.suffix not in {*TABLES, *PICTURES}:
        raise LogError(
            f"{path}: cannot be written as {path.suffix or 'a folder'}; a recorded drive must be "
            f"{', '.join([*TABLES, *sorted(PICTURES)])}"
        )
    refuse_existing(path, force, "--out")


def write(replayed: Replayed, path: Path, *, force: bool = False) -> None:
    """Write a replay: a table by ``.csv``, ``.parquet`` or ``.mf4``, or a picture.

    Time is exact: the log's own clock, from 1970 where the log has a date. nan is an empty cell.

    Raises:
        LogError: see ``refuse_output``, or the file cannot be written.
    """
    refuse_output(path, force)
    columns = replayed.columns
    masked: dict[str, Any] = {
        name: np.ma.masked_invalid(column) for name, column in columns.signals.items()
    }
    columns = replace(columns, signals=masked)
    with atomic(path, force=force) as part:
        if path.suffix in PICTURES:
            draw(part, replayed)
        elif path.suffix == ".mf4":
            with output(part, Contents({}, replayed.start_ns, False), True) as mf4:
                mf4.write({columns.name: columns})
        else:
            from can_rig.decoding.tables import write_table  # noqa: PLC0415 (pyarrow)

            write_table(part, columns, replayed.start_ns)


TABLES: Final = (".csv", ".parquet", ".mf4")


def draw(path: Path, replayed: Replayed) -> None:
    """Write the picture of a replay: a panel for each unit and for each code."""
    from can_rig.views.pictures import plot_page  # noqa: PLC0415 (matplotlib)

    signals = replayed.columns.signals
    endings = ("torque_nm", "force_difference_n", "speed_mps")
    others = [name for ending in endings for name in signals if name.endswith(ending)]
    names = ["dstar_mps2", "fault_estimate_mps2", *others, *CODES]
    columns = replace(replayed.columns, time_ns=replayed.columns.time_ns - replayed.start_ns)
    page = plot_page({"replay": columns}, [("replay", name) for name in names], 0)
    page.savefig(path, dpi=150)
