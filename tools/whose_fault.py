"""Whose fault it is said to be: each kind of fault in each scenario, and random faults.

The first table has a row for each kind of fault and a cell for each scenario: the verdict that
stood longest, after how many ms it was found, the peak of |D* - D* of the run without the fault|
from the fault on and, where it is no less than 0.005 m/s², that of the last second; in brackets
both without any compensation.

The second counts the verdicts on random faults of random size, in cars that are up to 20 % off,
with noise: a row for what was wrong, a column for what was said; then how many were worse than
without compensation, and the peaks of the one that was worst, with and without.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))

import click
import numpy as np

from can_rig.assessment.resolve import load
from can_rig.plant.frameless import frameless
from can_rig.scenario.build import network_of
from can_rig.scenario.fault_settings import FaultSettings
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.simulation import Trace
from firmware_model.law.status import Verdict

LANE_CHANGE: Final = ("reference.kind=lane-change", "reference.frequency_rad_per_s=1.34")
SCENARIOS: Final = {
    "default, lane change": ("default", *LANE_CHANGE, "fault.at_s=3.5", "duration_s=9"),
    **{name: (name,) for name in ("default", "noisy", "chassis-can")},
    **{name: (name,) for name in ("lane-change", "highway", "ideal")},
}
"""A scenario and its settings, by the head of its column."""
NOISY: Final = ("default", "noisy", "chassis-can")
FOR_S: Final = 4.0
SETTLED_MPS2, NOTHING_MPS2 = 5e-3, 1e-6  # from which on the first table says it
WRONGS: Final = 13
"""Kinds of what is wrong in the second table."""
WORSE, LEAST_MPS2 = 1.1, 0.01  # a peak that counts as worse than one without compensation
CHANGED: Final = (
    "mass_kg",
    "speed_mps",
    "front_cornering_stiffness_n_per_rad",
    "rear_cornering_stiffness_n_per_rad",
)
NO_FAULT: Final = (Verdict.NOTHING, Verdict.ANOTHER_CAR)

KINDS: Final = {
    "torque lost": "kind=actuator-dead",
    "half of it": "kind=actuator-dead left=0.5",
    "torque stuck where it is": "kind=actuator-stuck",
    "torque off by 20 N m": "kind=actuator-offset offset=20",
    "torque drifting, 5 N m/s": "kind=actuator-drift drift_per_s=5",
    "torque oscillating, 20 N m": "kind=actuator-oscillating amplitude=20",
    "torque limited to 100 N m/s": "kind=actuator-rate-limited rate_per_s=100",
    "torque late by 20 ms": "kind=actuator-late late_s=0.02",
    "torque frames missing": "kind=frames-missing",
    "every third corrupted": "kind=frames-corrupted every=3",
    "torque frames forged, 0 N m": "kind=frames-forged value=0",
    "force difference lost": "kind=actuator-dead channel=force-difference",
    "sensor biased, 0.1 m/s²": "kind=sensor-biased bias_mps2=0.1",
    "sensor drifting, 0.05 m/s²/s": "kind=sensor-drift drift_per_s=0.05",
    "sensor oscillating, 0.1 m/s²": "kind=sensor-oscillating amplitude=0.1",
    "sensor late by 20 ms": "kind=sensor-late late_s=0.02",
    "sensor dead": "kind=sensor-dead",
    "sensor shows half": "kind=sensor-dead left=0.5",
    "sensor stuck where it is": "kind=sensor-stuck",
    "sensor limited to 0.5 m/s²/s": "kind=sensor-rate-limited rate_per_s=0.5",
    "sensor frames forged, 0 m/s²": "kind=frames-forged channel=sensor value=0",
    "sensor frames missing": "kind=frames-missing channel=sensor",
}


class Outcome(NamedTuple):
    """What was said of a fault, and what it did."""

    verdict: Verdict
    after_s: float
    peak: float
    settled: float

    @property
    def deviation(self) -> str:
        """Its peak, and what it settles at unless that is less than ``SETTLED_MPS2``."""
        left = f", {self.settled:.1g}" if self.settled >= SETTLED_MPS2 else ""
        return f"{self.peak:.2g}{left}" if self.peak >= NOTHING_MPS2 else "0"


def fault_of(scenario: Scenario, kind: str, at_s: float, for_s: float | None) -> FaultSettings:
    """The fault of a row of ``KINDS``."""
    values = dict(each.split("=") for each in kind.split())
    if "late_s" in values:
        ticks = round(float(values.pop("late_s")) / scenario.tick_s)
        values["late_ticks"] = str(max(ticks, 1))
    numbers = {key: float(text) for key, text in values.items() if key not in ("kind", "channel")}
    whole = {key: int(numbers.pop(key)) for key in ("late_ticks", "every") if key in numbers}
    words = {key: values[key] for key in ("kind", "channel") if key in values}
    return FaultSettings(at_s=at_s, for_s=for_s, **words, **whole, **numbers)  # type: ignore[arg-type]


def outcome(scenario: Scenario, trace: Trace, healthy: Trace) -> Outcome:
    """What was said from the first fault on, as long as it was there; from the start without."""
    first = round(min([fault.at_s for fault in scenario.faults], default=0.0) / scenario.tick_s)
    there = min(round(FOR_S / scenario.tick_s), len(trace.verdict) - first)
    codes = trace.verdict[first : first + there]
    named = Counter(codes.tolist())
    for verdict in NO_FAULT:
        named.pop(int(verdict), None)
    said = Verdict(named.most_common(1)[0][0]) if named else Verdict.NOTHING
    deviation = np.abs(trace.measurement - healthy.measurement)[first:]
    last = round(1.0 / scenario.tick_s)
    return Outcome(
        said,
        float(np.argmax(codes == said)) * scenario.tick_s if named else np.nan,
        float(deviation.max()),
        float(deviation[-last:].max()),
    )


def by_kind(name: str) -> list[str]:
    """The cells of one scenario."""
    scenario = load(SCENARIOS[name][0], list(SCENARIOS[name][1:]))
    off = replace(scenario, design=replace(scenario.design, compensation="off"))
    network, at_s = network_of(scenario), scenario.loss.at_s
    runs = [replace(each, fault=()) for each in (scenario, off)]
    healthy = [frameless(each, network) for each in runs]
    cells = []
    for kind in KINDS.values():
        faults = (fault_of(scenario, kind, at_s, FOR_S),)
        with_it, without = (
            outcome(each, frameless(each, network), before)
            for each, before in zip(
                (replace(run, fault=faults) for run in runs), healthy, strict=True
            )
        )
        said = in_words(with_it.verdict)
        if with_it.verdict != Verdict.NOTHING:
            said += f" {1e3 * with_it.after_s:.4g} ms"
        cells.append(f"{said}; {with_it.deviation} ({without.deviation})")
    return cells


def in_words(verdict: Verdict) -> str:
    """A verdict as the tables have it."""
    return verdict.name.replace("_", " ").lower()


def drawn(seed: int) -> tuple[str, Scenario]:
    """What is wrong, and a drive in which it is."""
    draw = np.random.default_rng(seed)
    name = str(draw.choice(NOISY))
    at_s = float(draw.uniform(1.5, 6.0))
    scenario = load(name, [*LANE_CHANGE, f"seed={seed}", f"duration_s={at_s + FOR_S}"])
    shares = 1.0 + draw.uniform(-0.2, 0.2, len(CHANGED))
    car = {
        key: getattr(scenario.plant, key) * float(share)
        for key, share in zip(CHANGED, shares, strict=True)
    }
    scenario = replace(scenario, plant=replace(scenario.plant, **car))
    sign = float(draw.choice([-1.0, 1.0]))

    def size(low: float, high: float) -> float:
        return sign * float(np.exp(draw.uniform(np.log(low), np.log(high))))

    wrong, kinds = list(
        {
            "nothing": (),
            "torque lost": ("kind=actuator-dead",),
            "a part of it": (f"kind=actuator-dead left={draw.uniform(0.2, 0.8)}",),
            "torque offset": (f"kind=actuator-offset offset={size(10.0, 50.0)}",),
            "torque oscillating": (f"kind=actuator-oscillating amplitude={abs(size(10.0, 50.0))}",),
            "torque late": (f"kind=actuator-late late_s={draw.uniform(0.01, 0.05)}",),
            "both lost": (
                "kind=actuator-dead",
                "kind=actuator-dead channel=force-difference",
            ),
            "sensor biased": (f"kind=sensor-biased bias_mps2={size(0.03, 0.3)}",),
            "sensor drifting": (f"kind=sensor-drift drift_per_s={size(0.03, 0.3)}",),
            "sensor frozen": ("kind=sensor-stuck",),
            "sensor oscillating": (f"kind=sensor-oscillating amplitude={abs(size(0.03, 0.3))}",),
            "sensor late": (f"kind=sensor-late late_s={draw.uniform(0.01, 0.05)}",),
            "sensor shows a part": (f"kind=sensor-dead left={draw.uniform(0.2, 0.8)}",),
        }.items()
    )[seed % WRONGS]
    faults = tuple(
        fault_of(scenario, kind, at_s + number, None) for number, kind in enumerate(kinds)
    )
    return wrong, replace(scenario, fault=faults)


def confused(seed: int) -> tuple[str, str, float, float]:
    """What was wrong, what was said; the peak of the deviation, and that without compensation."""
    wrong, scenario = drawn(seed)
    network = network_of(scenario)
    trace = frameless(scenario, network)
    healthy = frameless(scenario.healthy, network)
    found = outcome(scenario, trace, healthy)
    off = replace(scenario, design=replace(scenario.design, compensation="off"))
    without = outcome(off, frameless(off, network), healthy)
    return wrong, in_words(found.verdict), found.peak, without.peak


def rows_of(header: str, columns: list[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """A table as the documents have it."""
    yield f"| {header} | {' | '.join(columns)} |"
    yield "|---" * (len(columns) + 1) + "|"
    for row in rows:
        yield f"| {' | '.join(row)} |"


@click.command()
@click.option("--runs", default=2000, show_default=True, help="Random faults.")
@click.option("--processes", default=2, show_default=True)
@click.option("--kinds/--no-kinds", default=True, show_default=True, help="The first table too.")
def main(runs: int, processes: int, kinds: bool) -> None:
    """Say whose fault is found to be what."""
    with ProcessPoolExecutor(processes) as pool:
        if kinds:
            columns = list(pool.map(by_kind, SCENARIOS))
            cells = zip(KINDS, *columns, strict=True)
            lines = rows_of("fault", list(SCENARIOS), (list(row) for row in cells))
            click.echo("\n".join(lines) + "\n")
        found = list(pool.map(confused, range(runs), chunksize=8))
    said = [in_words(verdict) for verdict in Verdict]
    wrongs = [drawn(seed)[0] for seed in range(WRONGS)]
    counts = Counter((wrong, verdict) for wrong, verdict, _, _ in found)
    worse = {wrong: sorted(_worse(found, wrong)) for wrong in wrongs}
    rows = [
        [
            wrong,
            *(str(counts[wrong, verdict] or "") for verdict in said),
            str(len(worse[wrong])),
            f"{worse[wrong][-1][1]:.2g} ({worse[wrong][-1][2]:.2g})" if worse[wrong] else "",
        ]
        for wrong in wrongs
    ]
    click.echo("\n".join(rows_of("wrong", [*said, "worse", "at worst"], rows)))


def _worse(
    found: list[tuple[str, str, float, float]], wrong: str
) -> Iterator[tuple[float, float, float]]:
    """By how much, and both peaks, of each that is worse than without compensation."""
    for what, _, peak, without in found:
        if what == wrong and peak > WORSE * without + LEAST_MPS2:
            yield peak - without, peak, without


if __name__ == "__main__":
    main()
