"""The reference of D*, one value per tick."""

from __future__ import annotations

import numpy as np

from can_rig.errors import ScenarioError
from can_rig.frames.network import Network
from can_rig.scenario.driving.csv_columns import over_time
from can_rig.scenario.driving.driver import lane_changes
from can_rig.scenario.remembered import remembered
from can_rig.scenario.settings import MAX_REFERENCE_MPS2, ReferenceSettings, Scenario
from firmware_model.target.structs import FloatArray

LANE_CHANGE_S = 1.0  # when a lane change begins


def on_the_bus(scenario: Scenario, network: Network) -> list[float]:
    """The reference of every tick, refused where its frame would saturate.

    Raises:
        ScenarioError: as ``refuse_saturation``.
    """
    refuse_saturation(scenario, network)
    fitting: list[float] = reference(scenario).tolist()
    return fitting


def refuse_saturation(scenario: Scenario, network: Network) -> None:
    """Refuse a reference beyond its frame's range.

    Raises:
        ScenarioError: values beyond the frame's range; refusals of ``reference``.
    """
    frame = network.reference
    largest = float(np.abs(reference(scenario)).max())
    if largest > frame.maximum:
        raise ScenarioError(
            f"scenario {scenario.name}: reference: reaches {largest:g} {frame.unit}; must be "
            f"at most {frame.maximum:g}, what {frame.name} carries"
        )


def reference(scenario: Scenario) -> FloatArray:
    """r at every tick of the run, shape (ticks,), m/s²; callers must not change the array.

    Raises:
        ScenarioError: an unreadable CSV, or times that fail to increase.
    """
    if scenario.reference.kind == "csv":
        return _from_csv(scenario, _times_s(scenario.ticks, scenario.tick_ns))
    return _computed(scenario.reference, scenario.ticks, scenario.tick_ns, scenario.tick_s)


@remembered(1)
def _computed(settings: ReferenceSettings, ticks: int, tick_ns: int, tick_s: float) -> FloatArray:
    time_s = _times_s(ticks, tick_ns)
    if settings.kind == "step":
        return np.full(ticks, settings.amplitude_mps2)
    if settings.kind == "sine":
        return settings.amplitude_mps2 * np.sin(settings.frequency_rad_per_s * time_s)
    if settings.kind == "lane-change":
        return lane_change(settings.amplitude_mps2, settings.frequency_rad_per_s, time_s)
    return lane_changes(settings, time_s, tick_s)


def _times_s(ticks: int, tick_ns: int) -> FloatArray:
    return np.arange(ticks, dtype=np.float64) * (tick_ns * 1e-9)


def lane_change(
    amplitude_mps2: float, frequency_rad_per_s: float, time_s: FloatArray
) -> FloatArray:
    """A double lane change from ``LANE_CHANGE_S`` on, m/s² at ``time_s``: there and back once.

    A sine period to the side, half a period of zero, the opposite sine period back. A sine's
    integral over its period is zero: as a lateral acceleration, each sine ends with zero lateral
    speed, displaced by 2πA/ω²; both together end on the initial lane. r is continuous, zero at
    begin and end; its slope, at most Aω, jumps there.
    """
    phase = frequency_rad_per_s * (time_s - LANE_CHANGE_S) / (2.0 * np.pi)  # in periods
    out, back = (phase >= 0.0) & (phase < 1.0), (phase >= 1.5) & (phase < 2.5)
    # Half a period later the same sine has the opposite sign, which suits the way back.
    return np.where(out | back, amplitude_mps2 * np.sin(2.0 * np.pi * phase), 0.0)


def _from_csv(scenario: Scenario, time_s: FloatArray) -> FloatArray:
    """Linear between the CSV's rows (time_s, reference_mps2), end values held; header optional."""
    where = f"scenario {scenario.name}: reference.file = {scenario.reference.file!r}"
    file, end_s = scenario.reference.file, scenario.duration_s
    times, references = over_time(file, where, "reference_mps2", end_s)
    largest, most = float(np.abs(references).max()), MAX_REFERENCE_MPS2
    if largest > most:
        raise ScenarioError(f"{where}: |reference_mps2| = {largest:g}: must be at most {most:g}")
    return np.interp(time_s, times, references)
