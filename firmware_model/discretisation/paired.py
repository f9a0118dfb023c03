"""One filter at several speeds, with the same poles and zeros in the same sections at each.

From speed to speed each root moves to the nearest root of the next speed. A conjugate pair at any
speed shares a section at all speeds, also where both roots are real; the middle speed decides the
sections of the other roots and the zeros over each pole. So the coefficients of a section are
smooth functions of the speed.

How the state of a discretised model turns as the speed of its car changes.

The accumulators of a cascade c (zI - A)⁻¹ b + d are s = T x, with x the state of the continuous
model: T maps each mode of the model to the cascade's mode with the same effect on the output.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from firmware_model.design.plants import Plant
from firmware_model.discretisation.rules import Rule
from firmware_model.discretisation.sections import (
    ComplexArray,
    Sections,
    reaching,
    realisation,
    section,
)
from firmware_model.discretisation.tustin import DeltaRoots
from firmware_model.errors import DesignError, ImproperError, ParameterError
from firmware_model.law.schedule import SIZE
from firmware_model.law.structs import FloatArray

Group = tuple[int, ...]
"""Numbers of the roots that share a section."""


def paired_alike(designs: Sequence[DeltaRoots], tick_s: float) -> list[Sections]:
    """The sections of each of ``designs``; ``designs`` are in order of speed.

    Raises:
        ParameterError: roots that appear, vanish or change partners between two speeds.
    """
    zeros = followed([zeros for zeros, _, _ in designs])
    poles = followed([poles for _, poles, _ in designs])
    if not poles.shape[1]:
        return [Sections(np.array([[gain, 0.0, 0.0, 0.0, 0.0]]), tick_s) for _, _, gain in designs]
    if zeros.shape[1] > poles.shape[1]:
        raise ImproperError(f"{zeros.shape[1]} zeros and {poles.shape[1]} poles: must not be more")
    pole_groups, zero_groups = groups(poles), groups(zeros)
    partners = _over(zeros, zero_groups, poles, pole_groups)
    found = []
    for k, (_, _, gain) in enumerate(designs):
        rows = np.array([
            section([complex(zeros[k, i]) for i in above], [complex(poles[k, i]) for i in below])
            for above, below in zip(partners, pole_groups, strict=True)
        ])  # fmt: skip
        rows[0][:3] *= gain
        found.append(Sections(rows, tick_s))
    return found


def followed(roots: Sequence[Sequence[complex]]) -> ComplexArray:
    """(speeds, n): each column follows a root from the first speed on.

    Raises:
        ParameterError: different numbers of roots.
    """
    rows = [np.array(roots[0], dtype=np.complex128)]
    for following in roots[1:]:
        after = np.array(following, dtype=np.complex128)
        if len(after) != len(rows[0]):
            raise ParameterError(
                f"{len(rows[0])} roots at one speed and {len(after)} at the next: must be as many"
            )
        rows.append(after[nearest(rows[-1], after)])
    return np.array(rows)


def nearest(roots: ComplexArray, others: ComplexArray) -> list[int]:
    """For each of ``roots`` (n,) its own of ``others`` (n,), the closest pairs first."""
    distance = np.abs(roots[:, None] - others)
    chosen = [0] * len(roots)
    for _ in roots:
        i, j = np.unravel_index(np.argmin(distance), distance.shape)
        chosen[int(i)] = int(j)
        distance[i, :] = distance[:, j] = np.inf
    return chosen


def groups(roots: ComplexArray) -> list[Group]:
    """Columns of ``followed`` that share a section: conjugates, then reals by size in pairs.

    Raises:
        ParameterError: a root changes its conjugate between speeds.
    """
    n = roots.shape[1]
    partner: dict[int, int] = {}
    for row in roots:
        for i in np.flatnonzero(row.imag > 0.0).tolist():
            j = int(np.argmin(np.abs(row - row[i].conjugate())))
            for one, other in ((i, j), (j, i)):
                if partner.setdefault(one, other) != other:
                    raise ParameterError(
                        f"the root at {row[one]:g} has another conjugate at another speed: a "
                        "design must be for fewer speeds"
                    )
    middle = np.abs(roots[len(roots) // 2])
    pairs = sorted({tuple(sorted(pair)) for pair in partner.items()}, key=lambda p: middle[p[0]])
    single = sorted((i for i in range(n) if i not in partner), key=lambda i: middle[i])
    return [*pairs, *(tuple(single[i : i + 2]) for i in range(0, len(single), 2))]


def _over(
    zeros: ComplexArray, above: list[Group], poles: ComplexArray, below: list[Group]
) -> list[Group]:
    """For each group of poles the zeros over the group: the nearest at the middle speed."""
    at = len(poles) // 2
    partners: list[Group] = [() for _ in below]
    for group in sorted(above, key=len, reverse=True):
        free = [i for i, p in enumerate(below) if not partners[i] and len(p) >= len(group)]
        partners[min(free, key=lambda i: _distance(poles[at], below[i], zeros[at], group))] = group
    return partners


def _distance(poles: ComplexArray, below: Group, zeros: ComplexArray, above: Group) -> float:
    return float(abs(poles[list(below)].mean() - zeros[above[0]]))


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
    # scipy's logm draws random numbers: its last digits differ from call to call
    factors, modes = np.linalg.eig((second @ np.linalg.inv(first)).astype(np.complex128))
    found = (modes * np.log(factors) @ np.linalg.inv(modes)).real
    generator[np.ix_(reached, reached)] = scale[:, None] * found / scale
    return generator


def coordinates(plant: Plant, sections: Sections, channel: int, rule: Rule) -> FloatArray:
    """T (n, n): from the channel's reachable state to the reachable accumulators.

    Raises:
        DesignError: as ``turn``.
    """
    a, _, c, _, reached = realisation(sections)
    own = np.flatnonzero(reaching(plant.a.T, plant.b[:, channel]))
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
