"""The reference of D*, one value per tick."""

from typing import Final

import numpy as np

from can_rig.errors import ScenarioError
from can_rig.frames.network import Network
from can_rig.scenario.recording import Column, over_time
from can_rig.scenario.remembered import remembered, state_of_file
from can_rig.scenario.settings import MAX_REFERENCE_MPS2, ReferenceSettings, Scenario
from can_rig.storage import paged
from firmware_model.compiled import compiled
from firmware_model.law.structs import FloatArray

COLUMNS: Final = (Column("reference_mps2"),)


def lane_changes(settings: ReferenceSettings, time_s: FloatArray, tick_s: float) -> FloatArray:
    """The reference of a driver at ``time_s``, spaced by one tick, shape (ticks,), m/s².

    The first of ``lane_changes_s`` leads to the other lane, the second back, alternating.
    """
    changes = np.sort(np.array(settings.lane_changes_s or (), dtype=np.float64))
    changed = np.searchsorted(changes, time_s + settings.preview_s, side="right")
    seen = (changed % 2).astype(np.float64) * settings.lane_m
    return _driven(seen, tick_s, settings.preview_s, settings.reaction_s, settings.amplitude_mps2)


@compiled
def _driven(
    seen: FloatArray, tick_s: float, preview_s: float, reaction_s: float, largest: float
) -> FloatArray:
    """The acceleration at every tick; ``seen`` is the lane's position at the preview point."""
    asked = np.zeros(len(seen))
    y, speed, acceleration = 0.0, 0.0, 0.0
    follows = 1.0 - np.exp(-tick_s / reaction_s)
    for k in range(len(seen)):
        asked[k] = acceleration
        wanted = 2.0 * (seen[k] - y - preview_s * speed) / (preview_s * preview_s)
        wanted = min(max(wanted, -largest), largest)
        y += tick_s * (speed + 0.5 * tick_s * acceleration)
        speed += tick_s * acceleration
        acceleration += follows * (wanted - acceleration)
    return asked


LANE_CHANGE_S = 1.0  # when a lane change begins


def refuse_saturation(scenario: Scenario, network: Network) -> None:
    """Refuse a reference beyond its frame's range.

    Raises:
        ScenarioError: values beyond the frame's range; refusals of ``reference``.
    """
    frame = network.reference
    values = reference(scenario)
    largest = max(float(values.max()), -float(values.min()))
    if largest > frame.maximum:
        reached = f"{largest:g} {frame.unit}".rstrip()
        raise ScenarioError(
            f"scenario {scenario.name}: reference: reaches {reached}; must be "
            f"at most {frame.maximum:g}, what {frame.name} carries"
        )


def reference(scenario: Scenario) -> FloatArray:
    """r at every tick of the run, shape (ticks,), m/s²; callers must not change the array.

    Raises:
        ScenarioError: an unreadable CSV, or times that fail to increase.
    """
    if scenario.reference.kind == "csv":
        return _from_csv(scenario)
    return _computed(scenario.reference, scenario.ticks, scenario.tick_ns, scenario.tick_s)


@remembered(1)
def _computed(settings: ReferenceSettings, ticks: int, tick_ns: int, tick_s: float) -> FloatArray:
    amplitude, frequency = settings.amplitude_mps2, settings.frequency_rad_per_s
    last = (settings.samples_mps2 or (0.0,))[-1]

    def part(rows: slice) -> FloatArray:
        time_s = _times_s(rows, tick_ns)
        if settings.kind == "step":
            return np.full(len(time_s), amplitude)
        if settings.samples_mps2 and settings.kind == "samples":
            samples = np.array(settings.samples_mps2[rows.start : rows.stop])
            return np.pad(samples, (0, len(time_s) - len(samples)), constant_values=last)
        if settings.kind == "sine":
            return amplitude * np.sin(frequency * time_s)
        return lane_change(amplitude, frequency, time_s)

    if settings.kind == "driver":
        return lane_changes(settings, _times_s(slice(0, ticks), tick_ns), tick_s)
    return paged.column(ticks, part)


def _times_s(rows: slice, tick_ns: int) -> FloatArray:
    return np.arange(rows.start, rows.stop, dtype=np.float64) * (tick_ns * 1e-9)


def lane_change(
    amplitude_mps2: float, frequency_rad_per_s: float, time_s: FloatArray
) -> FloatArray:
    """A double lane change from ``LANE_CHANGE_S`` on, m/s² at ``time_s``: there and back once.

    A sine period to the side, half a period of zero, the opposite sine period back. A sine's
    integral over its period is zero: as a lateral acceleration, each sine ends with zero lateral
    speed, displaced by 2πA/ω²; both together end on the initial lane. r is continuous, zero at
    begin and end; the slope of r, at most Aω, jumps there.
    """
    phase = frequency_rad_per_s * (time_s - LANE_CHANGE_S) / (2.0 * np.pi)  # in periods
    out, back = (phase >= 0.0) & (phase < 1.0), (phase >= 1.5) & (phase < 2.5)
    # Half a period later the same sine has the opposite sign, which suits the way back.
    return np.where(out | back, amplitude_mps2 * np.sin(2.0 * np.pi * phase), 0.0)


@remembered(
    1, by=lambda of: (of.reference, of.ticks, of.tick_ns, *state_of_file(of.reference.file))
)
def _from_csv(scenario: Scenario) -> FloatArray:
    """Linear between the CSV's rows (time_s, reference_mps2), end values held; header optional."""
    where = f"scenario {scenario.name}: reference.file = {scenario.reference.file!r}"
    file, end_s = scenario.reference.file, scenario.duration_s
    recorded = over_time(file, where, COLUMNS, end_s)
    times, references = recorded.time_s, recorded.values[COLUMNS[0].name]
    largest, most = float(np.abs(references).max()), MAX_REFERENCE_MPS2
    if largest > most:
        raise ScenarioError(f"{where}: |reference_mps2| = {largest:g}: must be at most {most:g}")
    return paged.column(
        scenario.ticks, lambda rows: np.interp(_times_s(rows, scenario.tick_ns), times, references)
    )
