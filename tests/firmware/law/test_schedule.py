"""Tables blended by the speed, and what models remember carried over."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from firmware_model.analysis.changing_plant import NO_WORLD, changing_plant, follow_changing
from firmware_model.analysis.simulation import Simulation
from firmware_model.design.vehicle import TABLE_3_2
from firmware_model.discretisation.sections import Sections
from firmware_model.firmware import Firmware
from firmware_model.law import controller
from firmware_model.law.core.biquad import advance, at_rest
from firmware_model.law.schedule import place_of
from tests.firmware.scheduled import LAGS, SPEEDS, TARGET, TICK_S, Blended, car, scheduled

OF = scheduled(cars=1)


def same(one, other):
    """Whether every number is; a record has gaps between them too."""
    if one.dtype.names is None:
        return np.array_equal(one, other)
    return all(same(one[name], other[name]) for name in one.dtype.names)


def sections_of(cascade):
    return Sections(cascade.coefficients[: cascade.n].copy(), TICK_S)


@pytest.mark.parametrize("i", range(len(SPEEDS)))
def test_at_the_speed_of_a_design_it_is_that_design(i):
    other = Blended(OF)
    other.to(SPEEDS[i])
    alone = scheduled((SPEEDS[i],), cars=1).table
    z = np.exp(1j * np.geomspace(1e-3, 3.0, 50))
    for get in (
        lambda t: t.tracking.filter, lambda t: t.estimator.channel_1,
        lambda t: t.estimator.channel_2, lambda t: t.compensator.filter,
        lambda t: t.other_cars.cars[0].channel_1, lambda t: t.other_cars.cars[0].channel_2,
    ):  # fmt: skip
        ours, its = (sections_of(get(t))(z) for t in (other.table, alone))
        assert np.abs(ours / its - 1.0).max() < 1e-8


def test_between_two_designs_it_is_a_straight_line_over_1_by_the_speed():
    low, high = SPEEDS[:2]
    ends = []
    for speed in (low, high):
        at = Blended(OF)
        at.to(speed)
        ends.append(at.table.estimator.channel_1.coefficients.copy())
    between = Blended(OF)
    speed = 12.7
    between.to(speed)
    share = (1 / low - 1 / speed) / (1 / low - 1 / high)
    expected = ends[0] + share * (ends[1] - ends[0])
    np.testing.assert_allclose(between.table.estimator.channel_1.coefficients, expected, rtol=1e-12)
    assert math.isclose(between.own.place, share, rel_tol=1e-12)


def test_speeds_beyond_the_designs_are_the_nearest_and_no_number_is_none():
    assert place_of(OF.schedule, 1.0) == 0.0
    assert place_of(OF.schedule, 99.0) == len(SPEEDS) - 1
    at = Blended(OF)
    at.to(13.0)
    before = at.table.copy()
    at.to(math.nan)
    at.to(13.0)
    assert same(at.table, before)


@pytest.mark.compiled
def test_the_motion_of_the_car_goes_on_at_another_speed():
    """What a cascade remembers, at either speed, by its free response; A and C know the answer."""
    rng = np.random.default_rng(1)
    for channel, kept in ((1, [0, 1, 2, 3, 4]), (2, [0, 1, 2, 3, 5])):
        at = Blended(OF)
        x = np.zeros(6)
        x[kept] = rng.standard_normal(5) * np.array([0.01, 0.05, 0.5, 0.02, 50.0])
        states = at.state.estimator[f"channel_{channel}"]
        for speed in (SPEEDS[0], SPEEDS[-1], SPEEDS[0]):
            if speed == SPEEDS[0] and at.own.place == 0.0:
                states.accumulators[:] = remembered(at, channel, x)
            else:
                begin = SPEEDS[0] if speed != SPEEDS[0] else SPEEDS[-1]
                for step in np.linspace(begin, speed, 300):
                    at.to(step)
            ours = free_response(at, channel, states.accumulators)
            expected = motion(speed, x)
            assert np.abs(ours - expected).max() < 2e-4 * np.abs(expected).max()


def motion(speed, x, ticks=300):
    plant = car(speed)
    phi = expm(plant.a * TICK_S)
    rows = [plant.c[0]]
    for _ in range(ticks - 1):
        rows.append(rows[-1] @ phi)
    return np.array(rows) @ x


def free_response(at, channel, accumulators, ticks=300):
    cascade, state = at.table.estimator[f"channel_{channel}"], at_rest()
    state.accumulators[:] = accumulators
    return np.array([advance(cascade, state, 0.0) for _ in range(ticks)])


def remembered(at, channel, x):
    """The accumulators of which the free response is the motion of x."""
    cascade = at.table.estimator[f"channel_{channel}"]
    places = [(i, j) for i, j in itertools.product(range(cascade.n), range(2))
              if j == 0 or cascade.coefficients[i, 2:5:2].any()]  # fmt: skip
    columns = []
    for place in places:
        unit = np.zeros_like(at_rest().accumulators)
        unit[place] = 1.0
        columns.append(free_response(at, channel, unit))
    matrix = np.array(columns).T
    scale = np.abs(matrix).max(axis=0)
    solution = np.linalg.lstsq(matrix / scale, motion(SPEEDS[0], x), rcond=None)[0] / scale
    found = np.zeros_like(at_rest().accumulators)
    for place, value in zip(places, solution, strict=True):
        found[place] = value
    return found


class Drive:
    """The car itself while its speed changes, for ``Simulation``."""

    def __init__(self, at, ticks):
        changing = changing_plant(TABLE_3_2, "physics", LAGS, 20.0, TICK_S)
        self._speeds = changing.speeds(at, range(ticks))
        n = len(changing.b)
        self._memory = np.zeros(n), np.zeros(n), np.zeros((2, 2)), np.zeros(1)
        self._constants, self._work = changing.constants, changing.work
        self._k = -1

    def follow(self, *commands):
        self._k += 1
        speeds = self._speeds[self._k]
        return follow_changing(
            self._constants, self._memory, self._work, speeds, self._k, *commands, NO_WORLD
        )


def speed_at(time_s):
    return 12.0 + 2.5 * np.clip(time_s / 0.4, 0.0, 1.0)


def healthy_estimate(of, ticks=450):
    time_s = TICK_S * np.arange(ticks)
    loop = Simulation(
        of.table,
        Drive(speed_at, ticks),
        2.0 * np.sin(12.0 * time_s),
        tick_s=TICK_S,
        schedule=of.schedule,
        speed=speed_at(time_s),
    )
    loop.run()
    return np.abs(loop.trace.fault_estimate).max()


@pytest.mark.compiled
@pytest.mark.parametrize("cars", range(5))
def test_a_healthy_car_that_gets_faster_shows_no_fault(cars):
    of = scheduled(cars=cars)
    assert of.table.other_cars.n == cars
    frozen = healthy_estimate(scheduled((12.0,)))
    assert healthy_estimate(of) < 0.003 < 0.1 * frozen


@pytest.mark.compiled
def test_without_the_turn_of_the_states_it_shows_one():
    of = scheduled()
    turned = healthy_estimate(of)
    for models in (of.schedule.model, *of.schedule.cars):
        models.turn_1[:] = models.turn_2[:] = 0.0
    assert healthy_estimate(of) > 5.0 * turned


def test_the_commands_of_a_firmware_are_those_of_its_working_table():
    firmware, at = Firmware(OF.table, speeds=OF.schedule), Blended(OF)
    plain = Firmware(OF.table)
    for tick in range(30):
        speed = 12.0 + 0.05 * tick
        firmware.change_speed(speed)
        plain.change_speed(speed)
        at.to(speed)
        r, y = math.sin(tick / 5.0), 0.1 * math.cos(tick / 3.0)
        controller.step(at.table, at.state, r, y)
        answer = firmware.step(r, y)
        assert answer[:3] == (at.state.command_1, at.state.command_2, at.state.fault_estimate)
        other = plain.step(r, y)
    assert other != answer


def test_the_first_ticks_of_a_drive_show_no_fault():
    assert healthy_estimate(OF, 12) < 1e-4


@pytest.mark.compiled
def test_single_precision_stays_single_and_is_as_near_as_it_can_be():
    single = scheduled(target=replace(TARGET, precision="float32"), cars=1)
    ours, exact = Blended(single), Blended(OF)
    for at in (ours, exact):
        at.state.estimator.channel_1.accumulators[:3] = 0.1
        for speed in np.linspace(SPEEDS[0], SPEEDS[-1], 50):
            at.to(speed)
    for part in ("estimator", "tracking", "compensator"):
        assert getattr(ours.table, part).dtype != getattr(exact.table, part).dtype
    one, other = (each.table.estimator.channel_1.coefficients for each in (ours, exact))
    assert one.dtype == np.float32
    np.testing.assert_allclose(one, other, rtol=2e-6)
    one, other = (each.state.estimator.channel_1.accumulators for each in (ours, exact))
    np.testing.assert_allclose(one[:3], other[:3], rtol=2e-4, atol=1e-6)


def test_one_speed_is_a_schedule_too():
    of = scheduled((12.0,))
    at = Blended(of)
    at.to(20.0)
    assert at.own.place == 0.0
    assert same(at.table, of.table)
