"""What a fault decision is worth: hours without a fault, hundreds of losses, other cars."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import click
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from can_rig.assessment.resolve import load
from can_rig.assessment.unavoidable import unavoidable
from can_rig.errors import RigError
from can_rig.frames.network import Network
from can_rig.plant.frameless import frameless
from can_rig.scenario.box import CAR as UNCERTAIN
from can_rig.scenario.box import in_box
from can_rig.scenario.build import controller_table, network_of
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.simulation import Trace
from firmware_model.target.status import FaultState
from firmware_model.target.structs import FloatArray, Record

LANE_CHANGES = (
    "reference.kind=lane-change",
    "reference.amplitude_mps2=1.0",
    "reference.frequency_rad_per_s=1.34",
    "duration_s=12",
)
EXCITED_NM = 10.0  # |u1| from which on a loss has to be found
AFTER_S = 0.5  # the loss, in which it has to be found


class Drives:
    """Drives of one scenario with noise of their own each, all with one table."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self._draw = np.random.default_rng(scenario.seed)
        self._network: Network = network_of(scenario)
        self._table: Record = controller_table(scenario, self._network)
        self._watched = round(AFTER_S / scenario.tick_s)
        silent = frameless(scenario.healthy.noise_free, self._network, self._table)
        torque = np.abs(silent.command_1[: -self._watched])
        self._excited = np.flatnonzero(torque >= EXCITED_NM)

    def healthy(self) -> Trace:
        """One in which nothing is lost."""
        return self._drive(self.scenario.healthy)

    def lose(self) -> tuple[float | None, float | None]:
        """From a loss at a random tick with |u1| >= 10 N m to its confirmation, and the bound, s.

        The bound is when the best test that knows the moment of the loss expects to tell.
        """
        tick_s = self.scenario.tick_s
        at = int(self._draw.choice(self._excited))
        fault = replace(
            self.scenario.fault,
            kind="actuator-dead",
            channel="torque",
            at_s=at * tick_s,
            for_s=None,
        )
        lost = replace(self.scenario, fault=fault)
        trace, watched = self._drive(lost), slice(at, at + self._watched)
        found = np.flatnonzero(trace.fault_state[watched] == FaultState.CONFIRMED)
        acting = trace.command_1[at - self.scenario.latency_ticks :][: self._watched]
        least = unavoidable(lost, acting)
        return (
            float(found[0]) * tick_s if len(found) else None,
            None if least is None else least.detection_ticks * tick_s,
        )

    def _drive(self, scenario: Scenario) -> Trace:
        seeded = replace(scenario, seed=int(self._draw.integers(1 << 62)))
        return frameless(seeded, self._network, self._table)


@click.group()
def main() -> None:
    """Long simulations, without frames, that no test has time for."""


@main.command()
@click.option("--scenario", "name", default="default", show_default=True)
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE")
@click.option("--hours", default=1.0, show_default=True, help="Driven without a fault.")
@click.option("--losses", default=300, show_default=True, help="At random, where |u1| >= 10 N m.")
def decision(name: str, settings: Sequence[str], hours: float, losses: int) -> None:
    """False alarms and detection delays on double lane changes, one after the other."""
    scenario = load(name, [*LANE_CHANGES, *settings])
    drives, budget = Drives(scenario), scenario.budget
    runs = round(hours * 3600.0 / scenario.duration_s)
    suspicions = alarms = 0
    for _ in track(range(runs), "driving"):
        state = drives.healthy().fault_state
        suspicions += entries(state, FaultState.SUSPECTED)
        alarms += entries(state, FaultState.CONFIRMED)
    found = [drives.lose() for _ in track(range(losses), "losing the torque")]
    delays = np.array([delay for delay, _ in found if delay is not None]) * 1e3
    over = np.array([d / least for d, least in found if d is not None and least is not None])
    bounds = np.array([least for _, least in found if least is not None]) * 1e3
    table = Table(title=f"{name}, double lane changes", box=None, show_header=False)
    table.add_row("noise of D*, rms", f"{scenario.plant.sensor.noise_mps2:g} m/s²")
    table.add_row("allowed false alarms (suspicions)", f"{budget.false_alarms_per_hour:g} an hour "
                  f"({budget.suspicions_per_hour:g})")  # fmt: skip
    table.add_row("driven", f"{runs * scenario.duration_s / 3600.0:.3g} h")
    table.add_row("false alarms (suspicions)", f"{alarms} ({suspicions})")
    table.add_row("losses, missed", f"{losses}, {losses - len(delays)}")
    for label, values, unit in (
        ("confirmed after", delays, " ms"),
        ("best test, expected", bounds, " ms"),
        ("the one over the other", over, ""),
    ):
        if len(values):
            middle, slow, worst = np.percentile(values, [50, 99, 100])
            table.add_row(
                f"{label}: median, 99 %, worst", f"{middle:.3g}, {slow:.3g}, {worst:.3g}{unit}"
            )
    Console().print(table)


def entries(state: np.ndarray, into: FaultState) -> int:
    """How often ``state`` becomes ``into``."""
    inside = state == into
    return int((inside[1:] & ~inside[:-1]).sum()) + int(inside[0])


@dataclass(frozen=True)
class CarDrive:
    """What became of one car in a scenario; the deviation is from its own healthy drive."""

    car: str
    alarm: bool
    delay_s: float | None
    peak_mps2: float
    settled_mps2: float


def other_cars(scenario: Scenario, box: float) -> Iterator[CarDrive]:
    """The 81 cars with mass, both stiffnesses and speed at -box, 0 and +box of the model."""
    network = network_of(scenario)
    table = controller_table(scenario, network)
    at, last = (round(s / scenario.tick_s) for s in (scenario.fault.at_s, 1.0))
    for places in product((-1.0, 0.0, 1.0), repeat=len(UNCERTAIN)):
        shares = {key: box * place for key, place in zip(UNCERTAIN, places, strict=True)}
        car = replace(scenario, plant=in_box(scenario.plant, shares))
        trace, sound = frameless(car, network, table), frameless(car.healthy, network, table)
        deviation: FloatArray = np.abs(trace.measurement - sound.measurement)
        found = np.flatnonzero(trace.fault_state[at:] == FaultState.CONFIRMED)
        yield CarDrive(
            ", ".join(f"{key} {share:+.0%}" for key, share in shares.items() if share),
            entries(sound.fault_state, FaultState.CONFIRMED) > 0,
            float(found[0]) * scenario.tick_s if len(found) else None,
            float(deviation[at:].max()),
            float(deviation[-last:].max()),
        )


@main.command()
@click.option("--scenario", "names", multiple=True, default=("default",), show_default=True)
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE")
@click.option("--box", default=0.2, show_default=True, help="How far the cars are off.")
def cars(names: Sequence[str], settings: Sequence[str], box: float) -> None:
    """The drive and the loss of a scenario with 81 cars that the design has not seen."""
    table = Table(title=f"81 cars, ±{box:.0%}; deviations in m/s²", box=None)
    for heading in ("scenario", "false alarms", "missed", "median, worst delay",
                    "median, worst peak", "worst settled"):  # fmt: skip
        table.add_column(heading, justify="left" if heading == "scenario" else "right")
    for name in names:
        driven = list(track(other_cars(load(name, settings), box), name, total=81))
        for drive in driven:
            if drive.alarm:
                Console().print(f"{name}: false alarm with {drive.car or 'the modelled car'}")
        delays = np.array([one.delay_s for one in driven if one.delay_s is not None]) * 1e3
        peaks = np.array([one.peak_mps2 for one in driven])
        table.add_row(
            name,
            str(sum(one.alarm for one in driven)),
            str(len(driven) - len(delays)),
            f"{np.median(delays):.3g}, {delays.max():.3g} ms" if len(delays) else "never",
            f"{np.median(peaks):.2g}, {peaks.max():.2g}",
            f"{max(one.settled_mps2 for one in driven):.1e}",
        )
        worst = driven[int(peaks.argmax())].car or "the modelled car"
        Console().print(f"{name}: worst peak with {worst}")
    Console().print(table)


if __name__ == "__main__":
    try:
        main()
    except RigError as error:
        raise SystemExit(f"error: {error}") from None
