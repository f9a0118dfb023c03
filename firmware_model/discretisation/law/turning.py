"""How the state of a discretised model turns as the speed of its car changes.

The accumulators of a cascade c (zI - A)⁻¹ b + d are s = T x, with x the state of the continuous
model: T maps each mode of the model to the cascade's mode with the same effect on the output.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from firmware_model.design.plants import Plant
from firmware_model.discretisation.law.paired import nearest
from firmware_model.discretisation.rules import Rule
from firmware_model.discretisation.sections import Sections, realisation
from firmware_model.errors import DesignError, ParameterError
from firmware_model.target.schedule import SIZE
from firmware_model.target.structs import FloatArray

WORST = 1e10  # condition of the modes of a model whose state is still told apart


def turn(
    before: tuple[Plant, Sections], after: tuple[Plant, Sections], channel: int, rule: Rule
) -> FloatArray:
    """(SIZE, SIZE), L of ``target.schedule`` from one speed to the next, over all accumulators.

    Args:
        before: the plant at the first speed, and the channel's sections.
        after: the same at the next speed.
        channel: 0 or 1.
        rule: the discretisation.

    Raises:
        ParameterError: model order above the capacity of the layout.
        DesignError: two coinciding modes, for example two equal lags in series.
    """
    reached = realisation(before[1])[4]
    if max(reached) >= SIZE:
        raise ParameterError(
            f"a model of {len(reached)} states: must have at most {SIZE} for several speeds"
        )
    ours = [coordinates(plant, sections, channel, rule) for plant, sections in (before, after)]
    generator = np.zeros((SIZE, SIZE))
    scale = np.linalg.norm(ours[0], axis=1)  # accumulators differ by powers of the tick
    first, second = (each / scale[:, None] for each in ours)
    found = linalg.logm(second @ np.linalg.inv(first)).real
    generator[np.ix_(reached, reached)] = scale[:, None] * found / scale
    return generator


def coordinates(plant: Plant, sections: Sections, channel: int, rule: Rule) -> FloatArray:
    """T (n, n): from the channel's reachable state to the reachable accumulators.

    Raises:
        DesignError: as ``turn``.
    """
    a, _, c, _, reached = realisation(sections)
    own = _reached(plant.a, plant.b[:, channel])
    if len(own) != len(reached):
        raise DesignError(
            f"{plant.name}: channel {channel + 1} has {len(own)} states and {len(reached)} after "
            "discretisation: must be as many for several speeds"
        )
    poles, modes = np.linalg.eig(plant.a[np.ix_(own, own)])
    z, sampled = np.linalg.eig(a)
    tick_s = sections.tick_s
    if rule == "zoh":
        expected = np.exp(poles * tick_s)
    else:
        expected = (2.0 + poles * tick_s) / (2.0 - poles * tick_s)
    sampled = sampled[:, nearest(expected, z)]
    if max(np.linalg.cond(modes), np.linalg.cond(sampled / np.abs(sampled).max())) > WORST:
        raise DesignError(
            f"{plant.name}: channel {channel + 1} has two modes that are hardly different: lags "
            "in series must not be equal for several speeds"
        )
    shown = (plant.c[0][own] @ modes) / (c @ sampled)
    turned: FloatArray = (sampled * shown @ np.linalg.inv(modes)).real
    return turned


def _reached(a: FloatArray, b: FloatArray) -> list[int]:
    """The states that an input drives, by a path of non-zeros."""
    found = b != 0.0
    while True:
        wider = found | (a[:, found] != 0.0).any(axis=1)
        if (wider == found).all():
            return [int(i) for i in np.flatnonzero(found)]
        found = wider
