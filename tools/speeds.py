"""The scenario drive-cycle with designs blended over the speed, and with one design at all speeds.

One row for each controller: the worst |r - D*| of a healthy car and from the loss of the motor on,
the worst d̂ of a healthy car without noise and with it, healthy runs in which a loss was confirmed
all the same, and how long after it the loss was.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import click
import numpy as np

from can_rig.assessment.resolve import load
from can_rig.plant.frameless import frameless
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.simulation import Trace
from firmware_model.law.status import FaultState

FIXED_MPS = (8.0, 15.0, 30.0)
ROW = "{:<16} {:>10} {:>10} {:>12} {:>12} {:>13} {:>11}"


@click.command()
@click.option("--seeds", default=5, show_default=True, help="Runs of each, with other noise.")
def main(seeds: int) -> None:
    """Drive the scenario drive-cycle with each controller."""
    click.echo(ROW.format("", "error", "error", "d̂ healthy", "d̂ healthy", "healthy runs", "loss"))
    click.echo(
        ROW.format(
            "design", "healthy", "after loss", "no noise", "with noise", "with alarms", "after"
        )
    )
    scenario = load("drive-cycle")
    for name, chosen in (
        ("blended", scenario),
        *((f"for {speed:g} m/s", fixed(scenario, speed)) for speed in FIXED_MPS),
    ):
        click.echo(ROW.format(name, *figures(chosen, seeds)))


def fixed(scenario: Scenario, speed_mps: float) -> Scenario:
    """The scenario with one design at all speeds."""
    return replace(scenario, design=replace(scenario.design, speeds_mps=(speed_mps,)))


def figures(scenario: Scenario, seeds: int) -> tuple[str, ...]:
    """The cells of one row."""
    network, lost = network_of(scenario), round(scenario.loss.at_s / scenario.tick_s)
    quiet = frameless(scenario.healthy.noise_free, network)
    healthy = [frameless(replace(scenario.healthy, seed=k), network) for k in range(seeds)]
    faulty = [frameless(replace(scenario, seed=k), network) for k in range(seeds)]
    confirmed = [
        np.flatnonzero(trace.fault_state[lost:] == FaultState.CONFIRMED)[:1] for trace in faulty
    ]
    late_ms = [float(at[0]) * scenario.tick_s * 1e3 for at in confirmed if len(at)]
    alarms = sum(bool((each.fault_state == FaultState.CONFIRMED).any()) for each in healthy)
    return (
        f"{max(worst(each, 0) for each in healthy):.3f}",
        f"{max(worst(each, lost) for each in faulty):.3f}",
        f"{np.abs(quiet.fault_estimate).max():.4f}",
        f"{max(np.abs(each.fault_estimate).max() for each in healthy):.4f}",
        f"{alarms} of {seeds}",
        f"{np.mean(late_ms):.0f} ms" if late_ms else "-",
    )


def worst(trace: Trace, begin: int) -> float:
    """The largest |r - D*| from the tick ``begin`` on, D* of the car, m/s²."""
    return float(np.abs(trace.reference - trace.measurement)[begin:].max())


if __name__ == "__main__":
    main()
