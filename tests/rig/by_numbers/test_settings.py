"""A plant by numbers in a scenario file: its transfer functions, its model, its names."""

import json
from dataclasses import replace

import control
import numpy as np
import pytest

from can_rig.drawing.names import names_of
from can_rig.scenario.box import in_box, uncertain
from can_rig.scenario.build import continuous_design, continuous_plant, network_of
from can_rig.scenario.loading import load, load_run
from can_rig.scenario.plant_settings import TransferFunction
from firmware_model.design.plants import chapter_2
from firmware_model.design.zpk import ZeroPoleGain
from tests.helpers import refuses
from tests.rig.by_numbers.plants import PLANTS, written

OMEGA = np.geomspace(1e-3, 1e3, 40)
CH2 = "chapter-2"


def response(settings: str | list[str], g: str) -> np.ndarray:
    plant = continuous_plant(
        load(CH2, settings if isinstance(settings, list) else [settings]).plant
    )
    return np.asarray(getattr(plant, g)(1j * OMEGA))


def test_chapter_2_is_a_scenario_of_transfer_functions():
    scenario, known = load(CH2), chapter_2()
    plant = continuous_plant(scenario.plant)
    assert (plant.g1, plant.g2) == (known.g1, known.g2)
    assert not scenario.design.feedback and continuous_design(scenario).tracking is None
    for own, other in zip((plant.a, plant.b, plant.c), (known.a, known.b, known.c), strict=True):
        assert (own == other).all()


def test_both_forms_are_the_same_function():
    num, den = [2.0, 6.0, 10.0], [1.0, 6.0, 13.0, 0.5]
    roots = control.tf(num, den)

    def pairs(values: np.ndarray) -> list[object]:
        return [
            float(v.real) if v.imag == 0 else [float(v.real), float(v.imag)]
            for v in values
            if v.imag >= 0
        ]

    polynomial = [f"plant.g1={{num={num}, den={den}}}"]
    factored = (
        f"plant.g1={{zeros={json.dumps(pairs(roots.zeros()))}, "
        f"poles={json.dumps(pairs(roots.poles()))}, gain=2}}"
    )
    expected = roots(1j * OMEGA)
    np.testing.assert_allclose(response(polynomial, "g1"), expected, rtol=1e-12)
    np.testing.assert_allclose(response([factored], "g1"), expected, rtol=1e-12)


@pytest.mark.parametrize("name", PLANTS)
def test_the_plant_is_that_of_python_control(tmp_path, name):
    settings = load(written(tmp_path, name)).plant
    bare = replace(settings, torque_actuator=type(settings.torque_actuator)())
    bare = replace(bare, force_difference_actuator=type(settings.force_difference_actuator)())
    plant = continuous_plant(bare)
    for channel, g in enumerate((plant.g1, plant.g2)):
        if settings.a is not None:
            system = control.ss(settings.a, np.array(settings.b)[:, channel : channel + 1],
                                [settings.c], 0.0)  # fmt: skip
        else:
            given = (settings.g1, settings.g2)[channel]
            system = control.tf(given.num, given.den)
        np.testing.assert_allclose(g(1j * OMEGA), system(1j * OMEGA), rtol=1e-9)
        own = plant.c @ np.linalg.solve(1j * np.eye(len(plant.a)) - plant.a, plant.b)
        np.testing.assert_allclose(own[0, channel], system(1j), rtol=1e-9)


def test_c_may_stand_as_the_matrix_of_one_row():
    row, matrix = (load("pendulum", [f"plant.c={c}"]).plant for c in ("[1, 0]", "[[1, 0]]"))
    assert matrix == row
    with refuses("plant.c.0 = [1, 0]: must be a valid number"):
        load("pendulum", ["plant.c=[[1, 0], [0, 1]]"])


def test_gain_and_speed_are_k_and_v_of_k_g_s_over_v():
    for function in (
        TransferFunction(num=(2.0, 3.0), den=(1.0, 2.0, 5.0)),
        TransferFunction(zeros=(-1.5,), poles=([-1.0, 2.0],), gain=2.0),
        TransferFunction(poles=(-3.0,), gain=-1.0),
    ):
        scaled = function.scaled(1.3, 0.7).factored
        expected = 1.3 * np.asarray(function.factored(1j * OMEGA / 0.7))
        np.testing.assert_allclose(scaled(1j * OMEGA), expected, rtol=1e-12)


@pytest.mark.parametrize("name", PLANTS)
def test_the_box_varies_gains_and_speed(tmp_path, name):
    settings = load(written(tmp_path, name)).plant
    own = continuous_plant(settings)
    for key in uncertain(settings):
        other = continuous_plant(in_box(settings, {key: 0.2}))
        for channel in ("1", "2"):
            ours, theirs = (getattr(plant, f"g{channel}") for plant in (own, other))
            touched = key in {f"gain_{channel}", f"speed_{channel}", "speed"}
            gain = 1.2 if key == f"gain_{channel}" else 1.0
            assert theirs.dc_gain == pytest.approx(gain * ours.dc_gain, rel=1e-9)
            assert (theirs(10j) != pytest.approx(ours(10j), rel=1e-6)) == touched


def test_the_model_follows_key_by_key():
    changed = load(CH2, ["plant.g1.gain=2", "model.g2.gain=3"])
    assert (changed.plant.g1.gain, changed.model.g1.gain) == (2, 2)
    assert (changed.plant.g2.gain, changed.model.g2.gain) == (1, 3)
    assert changed.model.g2.poles == changed.plant.g2.poles
    other_form = load(CH2, ["model.g1={num=[1, 3.1], den=[1, 3, 2]}"]).model.g1
    assert other_form.factored.zeros == (-3.1,) and other_form.zeros is None
    other_kind = load(CH2, ["model.kind=state-space", "model.a=[[-1]]", "model.b=[[1, 2]]",
                            "model.c=[1]"])  # fmt: skip
    assert other_kind.model.g1 == TransferFunction()
    assert continuous_plant(other_kind.model).g2 == ZeroPoleGain((), (-1,), 2.0)


def test_a_class_may_be_modelled_by_numbers():
    mixed = load(CH2, [
        "plant={kind='tests.rig.plant.linear:LinearPlant', output={name='rate', unit='rad/s'}}",
        "model={kind='state-space', a=[[-1]], b=[[1, 2]], c=[1]}",
    ])  # fmt: skip
    assert mixed.plant.is_class and mixed.model.a == ((-1,),)
    assert names_of(mixed.plant).output[:2] == ("rate", "rad/s")
    assert network_of(mixed).feedback.signal_name == "DStar"


def test_a_run_folder_has_it_all(tmp_path):
    for name in PLANTS:
        scenario = load(written(tmp_path, name), ["model.output={}"])
        again = load_run(json.loads(json.dumps(scenario.as_dict())))
        assert again == scenario


def test_names_are_those_of_the_scenario(tmp_path):
    names = names_of(load(written(tmp_path, "aircraft")).plant)
    assert [signal.name for signal in names] == ["pitch rate", "elevator", "canard"]
    assert [signal.unit for signal in names] == ["rad/s", "rad", "rad"]
    assert [signal.name for signal in names_of(load(CH2).plant)] == [
        "output y", "input 1", "input 2",
    ]  # fmt: skip


BUILT = {
    "plant.g1.poles=[1, -2]": "unstable poles of G1: 1 rad/s; of G2: none: must be the same",
    "plant.g1.zeros=[-3, -4]": "plant: G1 has 2 zeros and 2 poles: must have fewer zeros",
    "plant.g1.gain=0": "plant: transfer-functions: G1(s) is identically zero",
    "plant.g2.zeros=[0]": "G has a zero at 0+0j rad/s, on the imaginary axis",
}


@pytest.mark.parametrize(("setting", "line"), BUILT.items(), ids=BUILT)
def test_a_plant_that_no_design_exists_for_is_one_line(setting, line):
    with refuses(line):
        continuous_design(load(CH2, [setting]))


def test_a_zero_of_g1_in_the_right_half_plane_stays_in_the_closed_loop():
    right = ["plant.g1.zeros=[2]", "design.feedback=true"]
    tracking = continuous_design(load(CH2, right)).tracking
    assert tracking is not None and tracking.complementary.zeros == (2.0,)
    assert tracking.filter.is_stable() and tracking.stabiliser is None
