"""One filter at several speeds, with the same poles and zeros in the same sections at each.

From speed to speed each root moves to the nearest root of the next speed. A conjugate pair at any
speed shares a section at all speeds, also where both roots are real; the middle speed decides the
sections of the other roots and the zeros over each pole. So the coefficients of a section are
smooth functions of the speed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from firmware_model.discretisation.sections import ComplexArray, Sections, section
from firmware_model.discretisation.tustin import DeltaRoots
from firmware_model.errors import ImproperError, ParameterError

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
