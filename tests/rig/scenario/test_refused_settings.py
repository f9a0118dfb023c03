"""What a scenario may not say: one line that names the key, wherever the key stands."""

import re
import warnings
from collections.abc import Iterator

import pytest

from can_rig.errors import ScenarioError
from can_rig.scenario.controls import controls
from can_rig.scenario.loading import load
from tests.helpers import refuses
from tests.rig.scenario.page_of_keys import keys_of_the_page

KEYS = dict(keys_of_the_page())
TABLES: dict[str, list[str]] = {}
for each in KEYS:
    TABLES.setdefault(each.rpartition(".")[0], []).append(each)
BOUND = re.compile(r"([≥>≤<]) (-?\d[\d.]*(?:e[+-]?\d+)?)")
BOUNDS = {"≥": "at least", ">": "greater than", "≤": "at most", "<": "less than"}
OF_OTHER_TYPES = {
    "number": ("nan", "inf", "'x'", "true", "[1]", "2024-01-01"), "whole number": ("1.5", "'x'"),
    "text": ("5",), "list": ("5",), "true": ("3",), "one": ("zzz",), '"': ("zzz", "5"),
}  # fmt: skip
"""By the begin of what is allowed."""
BEGUN = {"disturbance": ("disturbance.kind=none",), "sensor": ("sensor.measures=yaw-rate",)}


def not_allowed(allowed: str) -> Iterator[tuple[str, str]]:
    """Values beside ``allowed``, and what the refusal of each says."""
    for begin, values in OF_OTHER_TYPES.items():
        if allowed.startswith(begin):
            yield from ((value, "must be") for value in values)
    whole = allowed.startswith("whole")
    for sign, bound in BOUND.findall(allowed) if "number" in allowed.partition(",")[0] else ():
        step = 1 if whole else 1e-9 * max(abs(float(bound)), 1e-3)
        value = (int if whole else float)(float(bound)) + step * {"≥": -1, "≤": 1}.get(sign, 0)
        value = f"[{value!r}]" if allowed.startswith("list") else repr(value)
        yield value, f"must be {BOUNDS[sign]} "


def set_to(key: str, value: str) -> None:
    load("default", [*BEGUN.get(key.partition(".")[0], ()), f"{key}={value}"])


@pytest.mark.parametrize("table", TABLES)
def test_what_the_page_of_keys_does_not_allow_is_one_line_that_names_the_key(table):
    for key in TABLES[table]:
        for value, line in not_allowed(KEYS[key]):
            with refuses(line) as caught:
                set_to(key, value)
            assert re.match(rf"scenario default: {key}(\.0)? = ", str(caught.value))


@pytest.mark.parametrize("table", TABLES)
def test_an_unknown_key_is_one_line_that_names_it_and_a_typo_gets_the_right_suggestion(table):
    unknown = f"{table}.zzz".lstrip(".")
    with refuses(f"{unknown}: unknown key"):
        set_to(unknown, "1")
    for key in TABLES[table]:
        name = key.rpartition(".")[2]
        if len(name) > 4 and not key.startswith(("model.", "controller.")):  # more of the same
            with refuses("unknown key") as caught:
                set_to(key[:-3] + key[-2:], "1")
            assert str(caught.value).endswith(f"did you mean {name}?")


RAMP = "drive.ramps=[[1, 10], [3, 16]]"
EXACT = {
    "design.tau_s=-1": "design.tau_s = -1: must be at least 0.000000001",
    "design.alpha=9": "design.alpha = 9: must be at most 8",
    "design.estimator=euler": "design.estimator = 'euler': "
    "must be 'tustin', 'tustin-held' or 'zoh'",
    "plant.mass_kg=heavy": "plant.mass_kg = 'heavy': must be a valid number",
    "plant.kind=boat": "plant.kind = 'boat': must be steer-by-wire, transfer-functions, "
    "state-space, fmu:FILE.fmu or package.module:Class",
    "fault.left=1": "fault.left = 1: must be less than 1",
    "tick_s=0": "tick_s = 0: must be at least 0.00001",
    "tick_s=nan": "tick_s = nan: must be a finite number",
    "reference=step": "reference = 'step': must be a table",
    "plant.g1=3": "plant.g1 = 3: must be a table, as { num = [...], den = [...] }",
    "controller.f2=0.5": "controller.f2 = 0.5: must be a table, as { num = [...], den = [...] } or "
    "{ sos = [[...]] }",
    "duration_s=0.0005": "duration_s = 0.0005: must be at least one tick (0.001 s)",
    "reference.kind=csv": 'reference.file: must name the CSV file of a reference of kind "csv"',
}
PARTS = {
    "tick_s=0.0000123456789": "nanoseconds", "duration_s=1e6": "10000000 ticks",
    "plant={mas=1}": "plant.mas: unknown key",
    "design.fault_threshold_mps2=0.02": "design.fault_threshold_mps2: unknown key",
    "model.kind=a:B": "model.kind = 'a:B'",
    "latency_ticks=from-budget": "latency_ticks = 'from-budget': must be a whole number of ticks",
    "seed=from-bus": "seed = 'from-bus': must be a valid integer",
    "design.tau_s=from-bus": "must be a valid number",
    "seed": "KEY=VALUE", "=5": "KEY=VALUE", "plant.=5": "KEY=VALUE", "": "KEY=VALUE",
    "tick_s.x=5": "tick_s", "plant.mass_kg.x=5": "mass_kg", "name=other": "name: unknown key",
    "fault={at_s=5.0}": "fault.kind: must be set where fault.at_s is",
    "fault=[{kind='none'}, {left=0.5}]": "fault.1.kind: must be set where fault.1.left is",
    "fault={knid='actuator-dead'}": "fault.knid: unknown key; did you mean kind?",
    "duration_s=": "duration_s",
}  # fmt: skip
DEFAULT = {
    ("plant.output.name='rate'",): "plant.output: must not be set for kind = 'steer-by",
    ("drive.speed_mps=10", "drive.ramps=[[0, 10]]"): "drive.ramps: must not stand beside speed_mps",
    ("drive.ramps=[[2, 10], [1, 12]]",): "time 1 s after 2 s: times must increase",
    ("drive.ramps=[[0, 10], [1, 101]]",): "must be at most 100",
    ("design.speeds_mps=[10, 12]",): "design.speeds_mps: must not be set without a drive",
    (RAMP, "design.speeds_mps=[12, 10]"): "design.speeds_mps: 10 after 12: must increase",
    (RAMP, "plant.kind=can_rig.plant.nonlinear_car:NonlinearCar"): "must be steer-by-wire",
    ("reference.kind=driver",): "lane_changes_s: must have a time",
    ("reference.kind=samples",): "samples_mps2: must have a value",
    ("reference={samples_mps2=[1.0]}",): "reference.kind: must be 'samples' where reference.sam",
    ("reference={lane_changes_s=[1.0]}",): "reference.kind: must be 'driver' where reference.lane_",
    ("reference={kind='driver', lane_changes_s=[1.0], amplitude_mps2=-1}",):
        "reference.amplitude_mps2 = -1: must be greater than 0",
    ("drive.ramps=[[0, 5], [1]]",): "drive.ramps.1 = [1]: must have one more value",
    ("fault=3",): "fault = 3: must be a table, or several",
    ("fault.kind=actuator-stuck", "fault.channel=sensor"):
        "fault.channel = 'sensor': must be torque or force-difference for 'actuator-stuck'",
    ("fault.kind=frames-forged",): "fault.value: must be set for 'frames-forged'",
    ("fault.kind=controller-restarted",): "fault.for_s: must be set for 'controller-restarted'",
    ("fault={kind='controller-restarted', for_s=1, every=2}",):
        "fault.every = 2: must be 1 for 'controller-restarted'",
    ("plant.torque_actuator.lag_s=1e-9",): "must be 0 (none) or at least 1e-06 s",
    ("plant.torque_actuator.lag_s=0.01", "plant.torque_actuator.natural_frequency_rad_per_s=100"):
        "plant.torque_actuator.lag_s = 0.01: must not stand beside natural_frequency_rad_per_s",
    ("plant.torque_actuator.dead_time_s=0.065",):
        "plant.torque_actuator.dead_time_s = 0.065: must be at most 0.064 s, 64 ticks",
    ("plant.sensor.dead_time_s=0.04", "plant.torque_actuator.dead_time_s=0.03"):
        "must be at most 0.024 s beside plant.sensor.dead_time_s = 0.04, 64 ticks in all",
    ("model.torque_actuator.limit_nm=5",):
        "model.torque_actuator.limit_nm = 5: must be limits.torque_nm",
    ("plant.parameters.x=[1]", "plant.kind=a:B"):
        "plant.parameters.x = [1]: must be a number, a text, true or false",
    ("plant.parameters.x=nan", "plant.kind=a:B"): "plant.parameters.x = nan: must be a finite",
    ("controller.parameters.x=-inf", "controller.kind=pi"):
        "controller.parameters.x = -inf: must be a finite number",
    ("plant.parameters.x=1",): "plant.parameters.x = 1: must not be set for kind",
}  # fmt: skip
SS = "plant={kind='state-space', "
SLOW = {
    "bus.bitrate=500000": '"from-bus": 500000 bit/s', "tick_s=0.0001": '"from-bus": 1000000 bit/s',
    "tick_s=1 bus.compute_s=63.9995": "latency_ticks = 65",
}  # fmt: skip
"""Too slow a bus, beside ``latency_ticks = "from-bus"``."""
BY_NUMBERS = {
    SS
    + "a=[[-1]], b=[[1, 1]], c=[1], mass_kg=900}": "mass_kg = 900: must not be set for kind = 's",
    "plant.kind=state-space": "g1: must not be set for kind = 'state-space'; kind = 'trans",
    "plant={kind='state-space'}": "plant.a: must be set for kind = 'state-space', which has a, b",
    SS + "a=[[-1]], b=[[1, 1]]}": "plant.c: must be set",
    SS + "a=[[-1, 0]], b=[[1, 1]], c=[1]}": "plant.a[0]: has length 2: must have 1",
    SS + "a=[[-1]], b=[[1]], c=[1]}": "plant.b[0]: has length 1: must have 2",
    SS + "a=[[-1]], b=[[1, 1], [0, 1]], c=[1]}": "plant.b: has 2 rows: must have 1, as many as a",
    SS + "a=[[-1]], b=[[1, 1]], c=[1, 0]}": "plant.c: has length 2: must have 1",
    SS + "a=[[-1]], b=[[1, 1e300]], c=[1]}": "plant.b[0] = 1e+300: must be at most 1e+100",
    SS + "a=[['x']], b=[[1, 1]], c=[1]}": "plant.a.0.0 = 'x': must be a valid number",
    "plant={kind='transfer-functions', g1={num=[1], den=[1, 1]}}": "plant.g2: must be set",
    "plant.g1={num=[1]}": "plant.g1.den: must be given beside num",
    "plant.g1={poles=[-1]}": "plant.g1.gain: must be given beside poles",
    "plant.g1.num=[1]": "plant.g1.zeros: must not stand beside num",
    "plant.g1={num=[1], den=[0, 0]}": "plant.g1.den = [0.0, 0.0]: must have a coefficient other",
    "plant.g1.poles=[-1, 'fast']": "plant.g1.poles[1] = 'fast': must be a number, or [real, imag",
    "plant.g1.poles=[[-1, -2]]": "plant.g1.poles[0] = [-1, -2]: must have an imaginary part above",
    "plant.g1.poles=[[-1, 2, 3]]": "plant.g1.poles[0] = [-1, 2, 3]: must be a number, or [real",
    "plant.g1.poles=[true]": "plant.g1.poles[0] = True: must be a number",
    "plant.input_1={x='rudder'}": "plant.input_1.x: unknown key; known: name, unit",
    "plant.input_1.name=''": "plant.input_1.name = '': must be a word or more",
    "plant.output.unit='$a$'": "plant.output.unit = '$a$': must be at most",
    "model.input_1.name='rudder'": "model.input_1: must be plant.input_1; a signal has one name",
    'plant.output.unit="\\u0007"': "plant.output.unit = ",
}
REFUSED = [
    *(("thesis-step", (given,), f"scenario thesis-step: {line}") for given, line in EXACT.items()),
    *(("thesis-step", (given,), part) for given, part in PARTS.items()),
    *(("default", settings, part) for settings, part in DEFAULT.items()),
    *(("thesis-step", ("latency_ticks=from-bus", *k.split()), part) for k, part in SLOW.items()),
    *(("chapter-2", (given,), part) for given, part in BY_NUMBERS.items()),
]


@pytest.mark.parametrize(("name", "settings", "line"), REFUSED)
def test_what_a_scenario_may_not_say_is_one_line_that_names_the_key(name, settings, line):
    with pytest.raises(ScenarioError) as caught, warnings.catch_warnings(action="error"):
        load(name, settings)
    message = str(caught.value)
    assert message == line if line.startswith("scenario ") else line in message
    assert "\n" not in message
    assert len(message) < 400


@pytest.mark.parametrize(
    "given", ["plant.mass_kg=10", "model.speed_mps=200", "plant.torque_actuator.lag_s=10"]
)
def test_a_box_that_leaves_the_bounds_of_a_key_is_one_line(given):
    name = given.partition("=")[0].rpartition(".")[2]
    with pytest.raises(ScenarioError, match=rf"a plant of budget.box: {name} = .*: must be at "):
        controls(load("default", (given, "budget.actuator_box=0.3")), None)
