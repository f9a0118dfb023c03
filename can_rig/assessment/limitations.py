"""Limits imposed by the modelled plant's zeros and poles, as lines of ``can-rig check``.

The healthy loop has the zeros of G1. After the loss the loop closes through G2: the zeros of G2 and
the longer of the two delays limit the loop too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from can_rig.drawing.names import names_of
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.settings import Scenario
from firmware_model.design.factors.coprime import unstable
from firmware_model.design.factors.limitations import Limitations, limitations
from firmware_model.design.zpk import Roots, ZeroPoleGain

MENTIONED = 1.01
"""Smallest relevant peak of |T|."""


def plant_limitations(scenario: Scenario) -> dict[str, Limitations]:
    """Of the loop ``healthy`` and ``faulted``, and of the ``compensation`` by itself."""
    plant = continuous_plant(scenario.model)
    poles, (first, second) = unstable(plant.g1), (_right(plant.g1), _right(plant.g2))
    latency_s = scenario.latency_ticks * scenario.tick_s
    first_s, second_s = (latency_s + dead_time_s for dead_time_s in plant.path_dead_times_s)
    return {
        "healthy": limitations(first, poles, first_s),
        "faulted": limitations((*first, *second), poles, max(first_s, second_s)),
        "compensation": limitations(second, ()),
    }


def describe(scenario: Scenario, found: dict[str, Limitations]) -> Iterator[str]:
    """A line for each reason; no line for a stable plant with minimum phase."""
    output, lost, other = names_of(scenario.plant)
    healthy, faulted, compensation = (found[key] for key in found)
    if continuous_plant(scenario.model).integrates:
        yield (
            f"plant: integrates: to hold {output.said} takes no {lost.short}, and a loss shows "
            "once there is some again"
        )
    if swinging := [pole.imag for pole in healthy.poles if pole.real == 0.0 < pole.imag]:
        listed = ", ".join(f"{omega:.3g}" for omega in swinging)
        yield f"plant: swings: nothing damps the motion of {output.said} at {listed} rad/s"
    if growing := tuple(pole for pole in healthy.poles if pole.real > 0.0):
        doubles_s = math.log(2.0) / max(pole.real for pole in growing)
        peak = ""
        if faulted.complementary > MENTIONED:
            peak = (
                f"; for any controller |T| peaks at {healthy.complementary:.3g} or more, "
                f"{faulted.complementary:.3g} after the loss"
            )
        yield (
            f"plant: unstable: poles at {_listed(growing)} double a motion of {output.said} "
            f"every {doubles_s:.2g} s{peak}"
        )
    if healthy.zeros:
        yield (
            f"plant: zeros from {lost.said} at {_listed(healthy.zeros)}: for any controller "
            f"{_bandwidth('a deviation', healthy)}"
        )
    if compensation.zeros:
        yield (
            f"plant: zeros from {other.said} at {_listed(compensation.zeros)}: for any "
            f"compensation {_bandwidth('a loss', compensation)}"
        )
    if faulted.zeros and faulted.poles:
        yield (
            f"plant: with zeros and poles as these |S| peaks at {healthy.sensitivity:.3g} or more, "
            f"{faulted.sensitivity:.3g} after the loss"
        )


def _bandwidth(what: str, found: Limitations) -> str:
    if found.halving_rad_per_s == 0.0:
        return f"{what} cannot be halved at any frequency without being doubled at another"
    return (
        f"{what} can be halved up to {found.halving_rad_per_s:.3g} rad/s at most, "
        "or it is more than doubled elsewhere"
    )


def _right(g: ZeroPoleGain) -> Roots:
    return tuple(zero for zero in g.zeros if zero.real > 0)


def _listed(roots: Roots) -> str:
    words = [
        f"{root.real:.3g}" if root.imag == 0.0 else f"{root.real:.3g} ± {root.imag:.3g}j"
        for root in roots
        if root.imag >= 0.0
    ]
    return f"{', '.join(words)} rad/s"


def without_roots(found: Limitations) -> dict[str, float]:
    """The bounds for JSON, without the roots, because JSON has no complex numbers."""
    return {
        "sensitivity": found.sensitivity,
        "complementary": found.complementary,
        "halving_rad_per_s": found.halving_rad_per_s,
    }
