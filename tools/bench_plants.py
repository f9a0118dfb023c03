"""Plants beyond the thesis's: what the loss costs, and the margins beside python-control's."""

from __future__ import annotations

import statistics

import numpy as np
from rich.console import Console
from rich.table import Table

import can_rig
from can_rig.scenario.build import continuous_plant, controller_table
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.margins import HEALTHY, TORQUE_DEAD, margins
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from tests.rig.by_numbers.by_control import loop, step_response

NAMES = ("two-masses", "nonminimum-phase", "oversteering", "pendulum", "satellite")
LOOPS = (
    ("healthy, no compensation", HEALTHY, "off"),
    ("healthy, compensated always", HEALTHY, "always"),
    ("after the loss, likewise", TORQUE_DEAD, "always"),
)
LINEAR = {
    "design.estimator": "zoh", "plant.sensor.noise_mps2": 0.0,
    "duration_s": 3.0, "fault.at_s": 1.5, "limits.torque_nm": 1e9, "limits.force_difference_n": 1e9,
}  # fmt: skip
"""What python-control can do: no decision, no limit, no noise."""


def bench_plants(seeds: int) -> None:
    """Print the metrics of runs with so many seeds, then the linear loops."""
    console = Console(width=150)
    runs = Table("scenario", "confirmed after, ms", "peak", "settled", "unavoidable", box=None)
    for name in NAMES:
        found = [_metrics(name, seed) for seed in range(seeds)]
        runs.add_row(name, *(_spread(column) for column in zip(*found, strict=True)))
    console.print(runs)
    loops = Table(
        "scenario", "loop", "peak |S|", "python-control's", "gain margin", "python-control's",
        "largest difference in a drive", box=None,
    )  # fmt: skip
    for name in NAMES:
        for word, left, compensation in LOOPS:
            scenario = can_rig.load_scenario(name, {**LINEAR, "design.compensation": compensation})
            loops.add_row(name, word, *_margins(scenario, left), _difference(scenario))
    console.print(loops)


def _metrics(name: str, seed: int) -> tuple[float, ...]:
    """Time to the confirmation in ms; peak and settled deviation, and the unavoidable one."""
    metrics = can_rig.run(name, {"seed": seed}).metrics
    wanted = (
        "detection_delay_s", "deviation_peak_after_fault_mps2",
        "deviation_settled_after_fault_mps2", "unavoidable_deviation_mps2",
    )  # fmt: skip
    delay_s, *deviations = (np.nan if metrics[key] is None else metrics[key] for key in wanted)
    return (1e3 * delay_s, *deviations)


def _spread(values: tuple[float, ...]) -> str:
    """Median and worst."""
    return f"{statistics.median(values):.3g} ({max(values):.3g})"


def _margins(scenario: Scenario, left: tuple[float, float]) -> tuple[str, str, str, str]:
    """Peak sensitivity and gain margin, each as found here and by python-control alone."""
    table = controller_table(scenario, None)
    found = margins(table, continuous_plant(scenario.plant), scenario.tick_s, left)
    omega = np.geomspace(1e-2, 0.999 * np.pi / scenario.tick_s, 4000)
    sensitivity = np.abs(loop(scenario, left).frequency_response(omega).frdata[4, 1]).max()
    below, above = 1.0, 1e4  # of the gain, stable and not
    while above - below > 1e-4 * below:
        gain = np.sqrt(below * above)
        stable = np.abs(loop(scenario, left, gain).poles()).max() < 1.0
        below, above = (gain, above) if stable else (below, gain)
    ours = (found.peak_sensitivity, found.gain_margin)
    return f"{ours[0]:.4f}", f"{sensitivity:.4f}", f"{ours[1]:.4f}", f"{below:.4f}"


def _difference(scenario: Scenario) -> str:
    """Between the firmware's drive through the loss and python-control's, of each signal's size."""
    left = np.ones((scenario.ticks, 2))
    left[round(scenario.loss.at_s / scenario.tick_s) :, 0] = 0.0
    drive = np.full(scenario.ticks, scenario.reference.amplitude_mps2)
    plant = sample(continuous_plant(scenario.plant), scenario.tick_s)
    run = simulate(controller_table(scenario, None), plant, drive, effectiveness=left)
    own = (run.measurement, run.command_1, run.command_2, run.fault_estimate)
    pairs = zip(own, step_response(scenario), strict=True)
    return f"{max(np.abs(a - b).max() / (np.abs(b).max() or 1.0) for a, b in pairs):.1e}"
