"""Designs for several speeds as the constants of ``target.schedule``, and the table for the first.

All designs share the values independent of the speed: rule, latency, limits, decision.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from operator import getitem
from typing import Any, cast

import numpy as np

from firmware_model.design.continuous_design import ContinuousDesign
from firmware_model.design.factors import unstable
from firmware_model.design.plants import Plant
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.monitor import widen_monitor
from firmware_model.discretisation.paired import paired_alike, turn
from firmware_model.discretisation.sections import Sections, make_up_gain
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import RULES, DeltaRoots, bilinear
from firmware_model.errors import DesignError, ParameterError, UnstablePlantError
from firmware_model.law.core import biquad
from firmware_model.law.layout import Table
from firmware_model.law.schedule import MAX_SPEEDS, Constants
from firmware_model.law.structs import zeroed

Path = tuple[str | int, ...]
"""Where a filter is in the schedule."""


@dataclass(frozen=True)
class AtSpeed:
    """The design for one speed.

    Attributes:
        speed_mps: V.
        design: of the model at this speed.
        target: the target, with the other cars of this speed in ``mismatch``.
        others: the other cars, in the same order.
    """

    speed_mps: float
    design: ContinuousDesign
    target: Target
    others: tuple[Plant, ...] = ()


@dataclass(frozen=True)
class Scheduled:
    """The table of the first speed and the schedule; no schedule for a constant speed."""

    schedule: Constants | None
    table: Table


def schedule(designs: Sequence[AtSpeed]) -> Scheduled:
    """The constants for ``designs``, ascending in speed, one or more.

    Raises:
        DesignError: a design without discretisation, an unstable model, models with modes that
            cannot be followed from speed to speed.
    """
    if not 0 < len(designs) <= MAX_SPEEDS:
        raise ParameterError(f"{len(designs)} speeds: must be 1 to {MAX_SPEEDS}")
    for each in designs:
        for plant in (each.design.plant, *each.others):
            if poles := unstable(plant.g1):
                raise UnstablePlantError(
                    f"{plant.name} at {each.speed_mps:g} m/s: pole at {poles[0]:.4g} rad/s: must "
                    "be stable at every speed"
                )
    tables = [build(each.design, each.target) for each in designs]
    made = zeroed(Constants, designs[0].target.precision)[0]
    made.n = len(designs)
    made.speed[: made.n] = [each.speed_mps for each in designs]
    filters = _filters(designs)
    for path, alike in filters.items():
        place = reduce(getitem, path, cast(Any, made))
        for k, sections in enumerate(alike):
            place[k, : sections.coefficients.size] = sections.coefficients.ravel()
    for k, table in enumerate(tables):
        made.tracking_inverse[k] = table.tracking.loop_inverse
        made.feedthrough_2[k] = table.estimator.feedthrough_2
        made.compensator_feedthrough[k] = table.compensator.feedthrough
        made.compensator_inverse[k] = table.compensator.loop_inverse
        for channel in (1, 2):
            gain = make_up_gain(filters["model", f"channel_{channel}"][k])
            made[f"make_up_{channel}"][k, : gain.size] = gain.ravel()
    _turn_states(made, designs, filters)
    return Scheduled(made, _first(tables, filters))


def _filters(designs: Sequence[AtSpeed]) -> dict[Path, list[Sections]]:
    """By its place in the schedule, the sections of each speed."""
    first = designs[0]
    tick_s, prewarp = first.target.tick_s, first.target.prewarp_rad_per_s
    sampled = RULES[first.target.estimator]
    one, nothing = ZeroPoleGain.constant(1.0), ZeroPoleGain.constant(0.0)

    def tracking(design: ContinuousDesign) -> ZeroPoleGain:
        return design.tracking.filter if design.tracking else one

    roots: dict[Path, list[DeltaRoots]] = {
        ("tracking",): [bilinear(tracking(each.design), tick_s, prewarp) for each in designs],
        ("compensator",): [
            bilinear(each.design.compensator or nothing, tick_s, prewarp) for each in designs
        ],
        ("model", "channel_1"): [sampled(each.design.plant.g1, tick_s) for each in designs],
        ("model", "channel_2"): [sampled(each.design.plant.g2, tick_s) for each in designs],
    }
    for car in range(len(first.others)):
        for channel in (1, 2):
            roots["cars", car, f"channel_{channel}"] = [
                sampled(each.target.mismatch.cars[car][channel - 1], tick_s) for each in designs
            ]
    found = {}
    for path, each in roots.items():
        try:
            found[path] = paired_alike(each, tick_s)
        except DesignError as error:
            raise ParameterError(f"{' '.join(map(str, path))}: {error}") from None
    return found


def _turn_states(
    made: Constants, designs: Sequence[AtSpeed], filters: dict[Path, list[Sections]]
) -> None:
    rule = designs[0].target.estimator
    cars: list[tuple[Path, list[Plant]]] = [(("model",), [each.design.plant for each in designs])]
    cars += [
        (("cars", i), list(each))
        for i, each in enumerate(zip(*(d.others for d in designs), strict=True))
    ]
    for path, plants in cars:
        place = reduce(getitem, path, cast(Any, made))
        for channel in (0, 1):
            alike = filters[*path, f"channel_{channel + 1}"]
            for k, (before, after) in enumerate(pairwise(zip(plants, alike, strict=True))):
                place[f"turn_{channel + 1}"][k] = turn(before, after, channel, rule).ravel()


def _first(each: Sequence[Table], filters: dict[Path, list[Sections]]) -> Table:
    """The first of the tables with its coefficients in the sections of the schedule."""
    tables = np.array(each[:1], each[0].dtype)
    own = tables[0]
    widen_monitor(own.monitor, [table.monitor for table in each])
    places: dict[Path, biquad.Constants] = {
        ("tracking",): own.tracking.filter,
        ("model", "channel_1"): own.estimator.channel_1,
        ("model", "channel_2"): own.estimator.channel_2,
        ("compensator",): own.compensator.filter,
    }
    for i, car in enumerate(own.other_cars.cars[: own.other_cars.n]):
        places["cars", i, "channel_1"] = car.channel_1
        places["cars", i, "channel_2"] = car.channel_2
    for path, cascade in places.items():
        sections = filters[path][0].coefficients
        cascade.coefficients[:] = 0.0
        cascade.n = len(sections)
        cascade.coefficients[: cascade.n] = sections
    for channel in (1, 2):
        gain = make_up_gain(filters["model", f"channel_{channel}"][0])
        own[f"shortfall_{channel}"].gain[: len(gain)] = gain
    tables.flags.writeable = False
    made: Table = tables[0]
    return made
