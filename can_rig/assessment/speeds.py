"""The check of a scenario with changing speed: at the ends of the drive, and between.

At the slowest speed with a design and at the fastest speed, the check equals the check at constant
speed. Between both ends the loop must be stable at every speed of a fine grid, and during the
fastest change, ``drive.speed_rate_max_mps2`` (``analysis.speed_sweep``).
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

from can_rig.assessment.stability import (
    DEAD,
    StabilityCheck,
    check_stability,
    finite_or_null,
    refuse_unstable,
)
from can_rig.errors import ScenarioError
from can_rig.scenario.build import continuous_plant, network_of
from can_rig.scenario.controls import controls
from can_rig.scenario.driving import designed_for, frozen, speed_profile
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.margins import HEALTHY, Margins
from firmware_model.analysis.speed_sweep import SpeedSweep, sweep
from firmware_model.design.plants import Plant


@dataclass(frozen=True, repr=False)
class DriveCheck(StabilityCheck):
    """Findings of ``check`` for a scenario with a drive, with the margins at the fastest speed.

    Attributes:
        ends: the check at the slowest and the fastest speed, by the speed in m/s.
        sweeps: between the ends, by the state of the actuators; empty for a design at a single
            speed.
    """

    ends: dict[float, StabilityCheck]
    sweeps: dict[str, SpeedSweep]

    @property
    def stable(self) -> bool:
        """At the ends, with every drive calm, and on the way."""
        checks = all(check.stable for check in self.ends.values())
        return checks and all(found.stable for found in self.sweeps.values())

    @property
    def states(self) -> Iterator[tuple[str, Margins]]:
        """Name and margins of each state: healthy and lost, at each end."""
        for speed, check in self.ends.items():
            for name, figures in list(check.states)[:2]:
                yield f"{speed:g} m/s {name}", figures

    @property
    def notes(self) -> Iterator[str]:
        """A line for each sweep, then the lines of the check at the fastest speed."""
        for name, found in self.sweeps.items():
            low, high = found.between_mps
            yield (
                f"speeds ({name}): at {found.speeds} of them the spectral radius is at most "
                f"{found.spectral_radius:.5f} ({found.at_mps:.3g} m/s); up and down at "
                f"{self.scenario.drive.speed_rate_max_mps2:g} m/s² {found.while_changing:.5f} a "
                f"tick ({low:.3g} to {high:.3g} m/s)"
            )
        fastest = max(self.ends)
        for note in self.ends[fastest].notes:
            yield f"{fastest:g} m/s: {note}"

    @property
    def verdict(self) -> str:
        """One line: stable, or the unstable state and a stable alternative."""
        for speed, check in self.ends.items():
            if not check.stable:
                return f"{speed:g} m/s: {check.verdict}"
        for name, found in self.sweeps.items():
            if not found.stable:
                return _unstable(name, found)
        return "stable: at every speed of the drive, and while it changes; every drive is calm"

    def as_dict(self) -> dict[str, Any]:
        """For JSON, where null stands for infinity and NaN."""
        return {
            "scenario": self.scenario.name,
            "stable": self.stable,
            "at_mps": {f"{speed:g}": check.as_dict() for speed, check in self.ends.items()},
            "sweeps": {name: finite_or_null(asdict(it)) for name, it in self.sweeps.items()},
        }


def check(
    scenario: Scenario, on_car: Callable[[int, int], None] = lambda done, of: None
) -> StabilityCheck:
    """``check_stability``, or the check of a drive.

    Raises:
        ScenarioError: as ``check_stability``; a drive that is none.
    """
    if not scenario.drive.is_given:
        return check_stability(scenario, on_car)
    ends = {end.plant.speed_mps: check_stability(end, on_car) for end in _ends(scenario)}
    findings = [finding for end in ends.values() for finding in end.findings]
    its = vars(ends[max(ends)]) | {"scenario": scenario, "findings": findings}
    return DriveCheck(**its, ends=ends, sweeps=_sweeps(scenario))


def refuse(scenario: Scenario, on_answer: Callable[[int], None] = lambda number: None) -> None:
    """``refuse_unstable`` at both ends of a drive and between.

    Raises:
        ScenarioError: as ``refuse_unstable``; a drive that is none.
    """
    if not scenario.drive.is_given:
        refuse_unstable(scenario, on_answer)
        return
    for end in _ends(scenario):
        try:
            refuse_unstable(end, on_answer)
        except ScenarioError as error:
            raise ScenarioError(f"{error} (at {end.plant.speed_mps:g} m/s)") from None
    for name, found in _sweeps(scenario).items():
        if not found.stable:
            raise ScenarioError(
                f"scenario {scenario.name}: {_unstable(name, found)}; --allow-unstable runs it"
            )


def _unstable(name: str, found: SpeedSweep) -> str:
    if not found.spectral_radius < 1.0:
        return (
            f"unstable at {found.at_mps:.3g} m/s ({name}): the spectral radius is "
            f"{found.spectral_radius:.4f} and must be below 1"
        )
    low, high = found.between_mps
    return (
        f"unstable while the speed changes from {low:.3g} to {high:.3g} m/s ({name}): grows by "
        f"{found.while_changing:.5f} a tick and must shrink; drive.speed_rate_max_mps2 must be less"
    )


def _ends(scenario: Scenario) -> list[Scenario]:
    """The scenario at its slowest and its fastest speed, with the design for that speed."""
    slowest, fastest = (designed_for(scenario, v) for v in speed_profile(scenario).range_mps)
    ends = [frozen(scenario, speed) for speed in dict.fromkeys((slowest, fastest))]
    alone = scenario.design.speeds_mps or ()
    if len(alone) != 1:
        return ends
    return [replace(end, model=replace(end.model, speed_mps=alone[0])) for end in ends]


def _sweeps(scenario: Scenario) -> dict[str, SpeedSweep]:
    if not scenario.controller.is_ours:
        return {}
    of = controls(scenario, network_of(scenario))
    if of.schedule is None:
        return {}

    def plant_at(speed_mps: float) -> Plant:
        return continuous_plant(replace(scenario.plant, speed_mps=speed_mps))

    lost = scenario.loss.channel
    states = {"healthy": HEALTHY, f"{lost} dead": DEAD[lost]}
    rate = scenario.drive.speed_rate_max_mps2
    return {name: sweep(of, plant_at, scenario.tick_s, rate, left) for name, left in states.items()}
