"""What a fault decision is worth: hours without a fault, hundreds of losses, other cars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import click
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from can_rig.assessment.resolve import load
from can_rig.assessment.stability import check_stability
from can_rig.errors import RigError
from can_rig.plant.frameless import frameless
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.simulation import Trace
from firmware_model.target.status import FaultState

LANE_CHANGES = (
    "reference.kind=lane-change",
    "reference.amplitude_mps2=1.0",
    "reference.frequency_rad_per_s=1.34",
    "duration_s=12",
)
EXCITED_NM = 10.0  # |u1| from which on a loss has to be found
AFTER_S = 0.5  # the loss, in which it has to be found
TRUE_CAR = "the modelled car"
CARS: dict[str, tuple[str, ...]] = {
    TRUE_CAR: (),
    "stiffness -20 %": (
        "plant.front_cornering_stiffness_n_per_rad=26960",
        "plant.rear_cornering_stiffness_n_per_rad=44960",
        "model.front_cornering_stiffness_n_per_rad=33700",
        "model.rear_cornering_stiffness_n_per_rad=56200",
    ),
    "mass +20 %": ("plant.mass_kg=1680", "model.mass_kg=1400"),
    "nonlinear tires": ("plant.kind=can_rig.plant.nonlinear_car:NonlinearCar",),
}


@click.group()
def main() -> None:
    """Long simulations, without frames, that no test has time for."""


@main.command()
@click.option("--scenario", "name", default="noisy", show_default=True)
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE")
@click.option("--hours", default=1.0, show_default=True, help="Driven without a fault.")
@click.option("--losses", default=300, show_default=True, help="At random, where |u1| >= 10 N m.")
def decision(name: str, settings: Sequence[str], hours: float, losses: int) -> None:
    """False alarms and detection delays on double lane changes, one after the other."""
    scenario = load(name, [*LANE_CHANGES, *settings])
    draw = np.random.default_rng(scenario.seed)
    drives = round(hours * 3600.0 / scenario.duration_s)
    suspicions = alarms = 0
    for _ in track(range(drives), "driving"):
        state = drive(scenario, draw).fault_state
        suspicions += entries(state, FaultState.SUSPECTED)
        alarms += entries(state, FaultState.CONFIRMED)
    delays, missed = [], 0
    for _ in track(range(losses), "losing the torque"):
        delay_s = lose(scenario, draw)
        if delay_s is None:
            missed += 1
        else:
            delays.append(delay_s * 1e3)
    table = Table(title=f"{name}, double lane changes", box=None, show_header=False)
    driven_h = drives * scenario.duration_s / 3600.0
    rms = scenario.plant.sensor.noise_mps2
    table.add_row("noise of D*, rms", f"{rms:g} m/s²")
    table.add_row("threshold, for", f"{scenario.design.fault_threshold_mps2:.3g} m/s²")
    table.add_row("driven", f"{driven_h:.3g} h")
    table.add_row("false alarms (suspicions)", f"{alarms} ({suspicions})")
    table.add_row("losses, missed", f"{losses}, {missed}")
    if delays:
        middle, slow, worst = np.percentile(delays, [50, 99, 100])
        table.add_row("confirmed after: median, 99 %, worst", f"{middle:g}, {slow:g}, {worst:g} ms")
    Console().print(table)


def drive(scenario: Scenario, draw: np.random.Generator, lost: int | None = None) -> Trace:
    """One drive with noise of its own; the torque is lost from tick ``lost`` on."""
    fault = replace(scenario.fault, kind="none")
    if lost is not None:
        at_s = lost * scenario.tick_s
        fault = replace(fault, kind="actuator-dead", channel="torque", at_s=at_s, for_s=None)
    scenario = replace(scenario, fault=fault, seed=int(draw.integers(1 << 62)))
    return frameless(scenario, network_of(scenario))


def lose(scenario: Scenario, draw: np.random.Generator) -> float | None:
    """Delay from a loss at a random tick with |u1| >= 10 N m to its confirmation, s."""
    silent = scenario.noise_free
    torque = np.abs(drive(silent, draw).command_1)
    watched = round(AFTER_S / scenario.tick_s)
    excited = np.flatnonzero(torque[:-watched] >= EXCITED_NM)
    at = int(draw.choice(excited))
    state = drive(scenario, draw, at).fault_state[at : at + watched]
    found = np.flatnonzero(state == FaultState.CONFIRMED)
    return float(found[0]) * scenario.tick_s if len(found) else None


def entries(state: np.ndarray, into: FaultState) -> int:
    """How often ``state`` becomes ``into``."""
    inside = state == into
    return int((inside[1:] & ~inside[:-1]).sum()) + int(inside[0])


@main.command()
@click.option("--scenario", "name", default="default", show_default=True)
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE")
def cars(name: str, settings: Sequence[str]) -> None:
    """A step and the loss of the torque with cars that the design has not seen."""
    table = Table(title=f"{name}: errors in m/s²", box=None)
    for heading in ("car", "stable", "settled before", "false alarm", "confirmed", "peak after",
                    "settled after"):  # fmt: skip
        table.add_column(heading, justify="left" if heading == "car" else "right")
    for label, changes in CARS.items():
        scenario = load(name, [*settings, *changes])
        trace = frameless(scenario, network_of(scenario))
        error, state = trace.reference - trace.measured, trace.fault_state
        at = round(scenario.fault.at_s / scenario.tick_s)
        last = round(1.0 / scenario.tick_s)
        confirmed = np.flatnonzero(state[at:] == FaultState.CONFIRMED)
        alarm = entries(state[:at], FaultState.CONFIRMED) > 0
        delay = f"{confirmed[0] * scenario.tick_s * 1e3:g} ms" if len(confirmed) else "never"
        table.add_row(
            label,
            "yes" if check_stability(scenario).stable else "no",
            f"{np.abs(error[at - last : at]).max():.1e}",
            "yes" if alarm else "no",
            "before" if alarm else delay,
            f"{np.abs(error[at:]).max():.2e}",
            f"{np.abs(error[-last:]).max():.1e}",
        )
    Console().print(table)


if __name__ == "__main__":
    try:
        main()
    except RigError as error:
        raise SystemExit(f"error: {error}") from None
