"""A linear control law by its filters' numbers."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from can_rig.controllers.protocol import Answer, Inputs
from can_rig.controllers.setup import ControllerSetup
from can_rig.errors import ScenarioError, one_line
from can_rig.scenario.controller_settings import FILTER_NAMES, FilterSettings
from firmware_model.discretisation.filters import Filter, discretise
from firmware_model.errors import DesignError
from firmware_model.law.structs import FloatArray

R, Y, U1, U2, D = range(5)
"""The signals of the law: reference, measurement, both commands, d̂."""

PATHS: Final[Mapping[str, tuple[Sequence[float], int]]] = {
    "c": ((1.0, -1.0, 0.0, 0.0, 0.0), U1),
    "u1_r": ((1.0, 0.0, 0.0, 0.0, 0.0), U1),
    "u1_y": ((0.0, 1.0, 0.0, 0.0, 0.0), U1),
    "f1_u1": ((0.0, 0.0, 1.0, 0.0, 0.0), D),
    "f1_u2": ((0.0, 0.0, 0.0, 1.0, 0.0), D),
    "f2": ((0.0, 1.0, 0.0, 0.0, 0.0), D),
    "f_hat": ((0.0, 0.0, 0.0, 0.0, 1.0), U2),
    "u2_r": ((1.0, 0.0, 0.0, 0.0, 0.0), U2),
    "u2_y": ((0.0, 1.0, 0.0, 0.0, 0.0), U2),
}
"""Each filter's input, as weights of the signals, and the signal that its output adds to."""

LOOP_FREE: Final = 1e-9
"""Smallest singular value of the equations of a tick."""


class FiltersLaw:
    """Filters between reference, measurement, commands and d̂; see ``protocol.Controller``.

    The filters are one system in δ = z - 1, x⁺ = x + Ax + B(r, y), (u1, u2, d̂) = Cx + D(r, y):
    the sections of the firmware, with every loop of a tick solved once. The names of ``filters``
    are those of ``PATHS``.

    Raises:
        ValueError: a loop without delay whose gain is one.
    """

    def __init__(self, filters: Mapping[str, Filter]) -> None:
        rows = [sections_of(name, each) for name, each in filters.items()]
        n = sum(len(b) for _, _, b, _, _ in rows)
        a, b = np.zeros((n, n)), np.zeros((n, 5))
        c, through = np.zeros((3, n)), np.zeros((3, 5))
        at = 0
        for name, of_a, of_b, of_c, of_d in rows:
            weights, output = np.array(PATHS[name][0]), PATHS[name][1] - U1
            own = slice(at, at + len(of_b))
            a[own, own], b[own] = of_a, np.outer(of_b, weights)
            c[output, own] = of_c
            through[output] += of_d * weights
            at += len(of_b)
        solved = np.eye(3) - through[:, U1:]
        if np.linalg.svd(solved, compute_uv=False)[-1] < LOOP_FREE:
            raise ValueError("f_hat and f1_u2 make a loop without delay whose gain is one")
        self.c, self.d = np.linalg.solve(solved, c), np.linalg.solve(solved, through[:, :U1])
        self.a, self.b = a + b[:, U1:] @ self.c, b[:, :U1] + b[:, U1:] @ self.d
        self._estimates = any(PATHS[name][1] == D for name in filters)
        self._x = np.zeros(n)

    def reset(self, reference: float) -> None:
        """The state that a measurement equal to the reference leaves as it is, the smallest one."""
        inputs = np.full(2, reference)
        self._x = np.linalg.lstsq(self.a, -self.b @ inputs, rcond=None)[0]

    def step(self, inputs: Inputs) -> Answer:
        """See ``protocol.Controller``."""
        w = np.array(inputs[:2])
        u1, u2, estimate = (self.c @ self._x + self.d @ w).tolist()
        self._x = self._x + (self.a @ self._x + self.b @ w)
        return Answer(u1, u2, estimate if self._estimates else None)


def sections_of(name: str, one: Filter) -> tuple[str, FloatArray, FloatArray, FloatArray, float]:
    """``name``, and A, b, c, d of a filter in δ: its sections in series."""
    coefficients = one.sections.coefficients
    size = 2 * len(coefficients)
    a, b, c, d = np.zeros((size, size)), np.zeros(size), np.zeros(size), 1.0
    row = np.zeros(size)  # of the signal between sections, as a sum of states
    for i, (b0, b1, b2, a1, a2) in enumerate(coefficients.tolist()):
        s1, s2 = 2 * i, 2 * i + 1
        out, out_d = b0 * row, b0 * d
        out[s1] += 1.0
        a[s1] += b1 * row - a1 * out
        a[s1, s2] += 1.0
        a[s2] += b2 * row - a2 * out
        b[s1], b[s2] = b1 * d - a1 * out_d, b2 * d - a2 * out_d
        row, d = out, out_d
    c = row
    used = [2 * i + j for i in range(len(coefficients)) for j in (0, 1)
            if j == 0 or coefficients[i, 2] or coefficients[i, 4]]  # fmt: skip
    return name, a[np.ix_(used, used)], b[used], c[used], float(d)


def filter_of(where: str, given: FilterSettings, tick_s: float) -> Filter:
    """The filter of a table.

    Raises:
        ScenarioError: an improper or unstable filter, or a form without its partner.
    """
    try:
        if given.sos is not None:
            return Filter.from_sos(given.sos, tick_s=tick_s)
        if given.domain == "s":
            return discretise(given.factored, tick_s, given.rule)
        if given.num is not None and given.den is not None:
            short = len(given.den) - len(given.num)
            return Filter.from_ba((0.0,) * short + given.num, given.den, tick_s=tick_s)
        of = given.factored
        return Filter.from_zpk(of.zeros, of.poles, of.gain, tick_s=tick_s)
    except DesignError as error:
        raise ScenarioError(f"{where}: {one_line(error)}") from None


def filters_law(setup: ControllerSetup) -> FiltersLaw:
    """The law of the kind ``filters``.

    Raises:
        ScenarioError: an invalid filter.
    """
    chosen = setup.scenario.controller
    filters = {
        name: filter_of(f"controller.{name}", getattr(chosen, name), setup.tick_s)
        for name in FILTER_NAMES
        if getattr(chosen, name)
    }
    try:
        return FiltersLaw(filters)
    except ValueError as error:
        raise ScenarioError(f"controller: {error}") from None
