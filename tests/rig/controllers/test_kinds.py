"""Controllers of every kind on the same frames: classes, filters, C libraries, FMUs, shipped."""

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import can_rig
from can_rig.assessment.stability import check_stability
from can_rig.assessment.tuning.search import tune
from can_rig.controllers.filters_law import FiltersLaw
from can_rig.controllers.library import HEADER
from can_rig.controllers.making import controller_of, peer_of
from can_rig.controllers.protocol import Answer, Inputs, said
from can_rig.errors import ExportError, RigError, ScenarioError
from can_rig.export.application import application
from can_rig.logs.reading import read_log
from can_rig.nodes.bus_access import StopRequest
from can_rig.plant.frameless import linear_law_of
from can_rig.replaying.estimator import replay_drive
from can_rig.replaying.replay import OpenLoop
from can_rig.results.execution import Options, execute, refuse, refuse_from_outside
from can_rig.results.metrics import metrics_of
from can_rig.results.signals import read_signals
from can_rig.results.source import source_of
from can_rig.scenario.build import network_of
from can_rig.scenario.controller_settings import PEERS
from can_rig.scenario.controls import controller_table
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from can_rig.thesis.comparisons import compare_scenario
from firmware_model.analysis.read_off import read_off
from firmware_model.analysis.sampled_loop import linear_controller
from firmware_model.discretisation.filters import discretise
from firmware_model.firmware import Firmware
from firmware_model.law.structs import FloatArray
from tests.rig.plant.fmu.building import build

CAR = Path(__file__).parents[3] / "docs" / "car"
SHORT = ["duration_s=0.6", "fault.at_s=0.3"]
FILTERS = [
    "controller.kind=filters", "controller.c.num=[20.0, 100.0]", "controller.c.den=[1.0, 0.0]",
    "controller.f1_u1.num=[0.02]", "controller.f1_u1.den=[0.1, 1.0]", "controller.f2.num=[-1.0]",
    "controller.f2.den=[0.02, 1.0]", "controller.f_hat.num=[1000.0]", "controller.f_hat.den=[1.0]",
]  # fmt: skip


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A folder of one's own, which imports look into; afterwards its modules are forgotten."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def of(kind: str, *settings: str) -> Scenario:
    return load("default", [f"controller.kind={kind}", *SHORT, *settings])


def logged(scenario: Scenario, where: Path, bus: str | None = None) -> bytes:
    done = execute(scenario, where, StopRequest(), Options(report=False, bus=bus))
    assert done is not None
    assert done.failure is None, done.failure
    return (where / "bus.log").read_bytes()


def test_the_report_of_another_controller_has_no_run_without_its_compensation(tmp_path):
    done = execute(of(PEERS["pi"]), tmp_path / "run", StopRequest(), Options())
    assert (done.folder / "report.png").is_file()
    assert done.metrics["deviation_peak_mps2"] > 0.0
    assert done.metrics["deviation_peak_uncompensated_mps2"] is None


@pytest.mark.parametrize("kind", [*PEERS, "filters"])
def test_with_and_without_frames_the_log_is_the_same(kind, tmp_path):
    scenario = of(kind) if kind != "filters" else load("default", [*FILTERS, *SHORT])
    without = logged(scenario, tmp_path / "without")
    assert logged(scenario, tmp_path / "frames", "virtual:kinds") == without
    assert without != logged(of("ours"), tmp_path / "ours")


def test_what_a_controller_does_not_say_is_empty(tmp_path):
    for kind, says in (("pi", []), ("kalman", ["fault_estimate_mps2", "fault_state"])):
        scenario = of(kind)
        logged(scenario, tmp_path / kind)
        signals = read_signals(tmp_path / kind / "bus.log", network_of(scenario), scenario.tick_s)
        for name in ("fault_estimate_mps2", "fault_state", "verdict"):
            column = getattr(signals, name)
            assert np.isfinite(column).all() == (name in says), (kind, name)
            assert np.isnan(column).all() == (name not in says), (kind, name)
        assert (signals.mode == 1).all()


CLAIMS = (
    "missed_detection", "detection_delay_s", "suspicions", "false_alarms", "false_alarms_per_hour",
)  # fmt: skip
VERDICTS = ("verdict", "right_place", "wrong_place")


@pytest.mark.parametrize("kind", ["pi", "kalman"])
def test_no_figure_is_made_of_what_a_controller_does_not_say(kind):
    for channel in ("torque", "force-difference"):
        found = metrics_of(of(kind, "fault.kind=actuator-dead", f"fault.channel={channel}"))
        says = kind == "kalman" and channel == "torque"
        assert [found[name] is not None for name in VERDICTS] == [False] * 3
        assert [found[name] is not None for name in CLAIMS[:2]] == [says] * 2
        assert [found[name] is not None for name in CLAIMS[2:]] == [kind == "kalman"] * 3
        assert found["place"] == channel


@pytest.mark.parametrize("kind", ["pi", "kalman", "thesis"])
def test_a_log_replays_through_the_controller_that_made_it(kind, tmp_path):
    scenario = of(kind)
    logged(scenario, tmp_path / "run")
    found = []
    for other in (scenario, of("allocation")):
        loop = OpenLoop(other, network_of(other))
        loop.run(read_log(tmp_path / "run" / "bus.log"))
        found.append(loop.comparison)
    assert [each.identical for each in found] == [True, False]
    assert found[0].compared == scenario.ticks


def test_a_code_says_what_is_not_said():
    assert said(Answer(0.0, 0.0))[2:] == (3, 14)
    assert said(Answer(0.0, 0.0, fault_state=1))[2:] == (1, 15)
    assert said(Answer(0.0, 0.0, 1.0, 2, 2, 4)) == (1.0, 2, 2, 4)


# --- a class -------------------------------------------------------------------------------------

BAD = {
    "return 1 / 0, 0.0": r"step failed at 0 s: ZeroDivisionError: .* \(.*bad\.py, line 7\)",
    "return float('nan'), 0.0": r"step at 0 s answers \(nan, 0\.0\): command_1 must be a finite",
    "return 0.0, 1e400": r"step at 0 s answers \(0\.0, inf\): command_2 must be a finite",
    "return 0.0, 10**400": r"step at 0 s answers \(0.0, 10{90}\.\.\.: command_2 must be a finite",
    "return __import__('numpy').array([[1.0], [0.0]])": r"command_1 must be a finite number",
    "return 1.0": r"step at 0 s answers 1\.0: must be \(command_1, command_2\) or an Answer",
    "return 1.0, 2.0, 3.0": r"answers \(1\.0, 2\.0, 3\.0\): must be \(command_1, command_2\) or an",
    "return __import__('can_rig').controllers.protocol.Answer(1.0, 2.0, 3.0, 9)": (
        r"mode must be None or a code of 0 to 3"
    ),
    "raise SystemExit": r"step failed at 0 s: SystemExit",
    "raise type('Mute', (Exception,), {'__str__': lambda self: 1 / 0})": (
        r"step failed at 0 s: Mute: <exception str\(\) failed> \(.*bad\.py, line 7\)"
    ),
    "return type('Mute', (), {'__repr__': lambda self: 1 / 0})()": (
        r"step at 0 s answers a Mute: must be \(command_1, command_2\) or an Answer"
    ),
}


@pytest.mark.parametrize("body", BAD)
def test_a_bad_answer_is_one_line(body, own):
    (own / "bad.py").write_text(
        "class Bad:\n    def __init__(self, setup):\n        pass\n"
        "    def reset(self, reference):\n        pass\n"
        f"    def step(self, inputs):\n        {body}\n"
    )
    with pytest.raises(RigError, match=BAD[body]) as caught:
        peer_of(of("bad:Bad")).step(Inputs(0.0, 0.0))
    assert "\n" not in str(caught.value)


def test_a_further_sensor_has_its_name_before_its_first_frame(own, tmp_path):
    """So ``check``, which has no sensors, accepts a controller that listens to a sensor."""
    (own / "listens.py").write_text(
        "def step(inputs):\n"
        "    heard = inputs.witnesses['measured_yaw_rate_rad_per_s']\n"
        "    age = inputs.witnesses['measured_yaw_rate_rad_per_s_age_ticks']\n"
        "    assert (heard == heard) == (age == age)\n"
        "    return 5.0 * (inputs.reference - inputs.measurement), 100.0 * (heard == heard)\n"
    )
    settings = ["controller.kind=listens:step", "fault.kind=none", "budget.box=0", *SHORT[:1]]
    scenario = load("cluster", settings)
    assert peer_of(scenario).step(Inputs(1.0, 0.0))[:2] == (5.0, 0.0)
    said = "\n".join(check_stability(scenario).notes)
    assert "margins: of the controller without what the further sensors say" in said
    logged(scenario, tmp_path / "run")
    signals = read_signals(tmp_path / "run" / "bus.log", network_of(scenario), scenario.tick_s)
    heard = np.isfinite(signals.sensors["measured_yaw_rate_rad_per_s"])
    np.testing.assert_array_equal(signals.force_difference_n == 100.0, heard)
    assert 0 < heard.sum() < len(heard)


def test_an_array_of_no_dimension_is_a_number(own):
    (own / "bad.py").write_text(
        "import numpy as np\n\ndef step(inputs):\n"
        "    return np.array(2.0) * inputs.reference, np.array(3)\n"
    )
    answer = peer_of(of("bad:step")).step(Inputs(1.5, 0.0))
    assert answer[:2] == (3.0, 3.0)
    assert all(type(command) is float for command in answer[:2])


MODULES = {
    "class C:\n    pass": r"C\(\): must be C\(setup\)",
    "class C:\n    def __init__(self, setup): pass": r"no method reset and no method step",
    "import nothing_such": r"cannot be imported: ModuleNotFoundError: .*nothing_such",
    "class D:\n    pass": r"no class or function C in .*bad_module\.py",
    "class C:\n    def __init__(self, setup): raise KeyError(3)": r"KeyError: 3 \(.*line 2\)",
    "raise SystemExit": r"bad_module cannot be imported: SystemExit",
    "class C(": r"cannot be imported: SyntaxError",
}


@pytest.mark.parametrize("text", MODULES)
def test_a_bad_class_is_refused_before_the_run(text, own):
    (own / "bad_module.py").write_text(text + "\n")
    with pytest.raises(RigError, match=MODULES[text]) as caught:
        refuse(of("bad_module:C"))
    assert str(caught.value).startswith("controller.kind = 'bad_module:C': ")


@pytest.mark.parametrize(
    ("kind", "right"),
    [("other:C", r"no module other, neither installed nor in .*"),
     ("sub/other:C", r"no module other, neither installed nor in .*/sub$"),
     ("mine.py:C", r"no class or function C in .*/mine\.py$"),
     ("./sub/math:log", r"math is .*, which hides .*/sub/math\.py: rename that file"),
     ("math:C", r"no class or function C in .*math.*, which hides .*/math\.py: rename that file"),
     ("sub.mine:C", r"no class or function C in .*sub/mine\.py$")],
)  # fmt: skip
def test_a_class_that_is_not_found_says_where_to_look(kind, right, own):
    (own / "sub").mkdir()
    for name in ("mine", "math", "sub/mine", "sub/math"):
        (own / f"{name}.py").touch()
    with pytest.raises(ScenarioError, match=right):
        refuse(of(kind))


MINE = (
    "class Mine:\n    def __init__(self, setup): self.kp = setup.number('kp', 20.0)\n"
    "    def reset(self, reference): pass\n"
    "    def step(self, inputs): return self.kp * inputs.reference, 0.0\n"
)


@pytest.mark.parametrize(
    "kind", ["mine:Mine", "mine.py:Mine", "../a/mine:Mine", "package.mine:Mine"]
)
def test_a_class_beside_the_scenario_is_found_from_every_folder(kind, own):
    (own / "a" / "package").mkdir(parents=True)
    (own / "mine.py").write_text(MINE.replace("20.0", "1.0"))  # not this file: of the folder itself
    for folder in ("a", "a/package"):
        (own / folder / "mine.py").write_text(MINE)
    (own / "a" / "car.toml").write_text(f"[controller]\nkind = '{kind}'\n")
    scenario = load("a/car.toml")
    assert peer_of(scenario).step(Inputs(1.0, 0.0)).command_1 == 20.0
    with pytest.MonkeyPatch.context() as elsewhere:
        saved = can_rig.save_scenario(scenario, own / "saved.toml")
        elsewhere.chdir("/")
        assert peer_of(load(str(saved))).step(Inputs(1.0, 0.0)).command_1 == 20.0


@pytest.mark.parametrize(
    ("kind", "line"),
    [
        ("pi", "controller.parameters.kpp: unknown; known: lag_s, lambda_s"),
        ("thesis", "controller.parameters.kpp: unknown; known: none"),
        ("mine:Mine", "controller.parameters.kpp: unknown; known: kp"),
    ],
)
def test_a_parameter_that_the_controller_never_reads_is_refused(kind, line, own):
    (own / "mine.py").write_text(
        MINE + "class Reads(Mine):\n"
        "    def __init__(self, setup): self.kp = len(setup.parameters)\n"
    )
    refuse(of("mine:Mine", "controller.parameters.kp=3"))
    refuse(of("mine:Reads", "controller.parameters.kpp=3"))
    with pytest.raises(ScenarioError) as caught:
        refuse(of(kind, "controller.parameters.kpp=3"))
    assert str(caught.value) == line


@pytest.mark.parametrize("value", ['"3"', "true"])
def test_a_parameter_that_is_no_number_is_named(value):
    with pytest.raises(
        ScenarioError, match=r"controller\.parameters\.lag_s = .*: must be a number$"
    ):
        refuse(of("pi", f"controller.parameters.lag_s={value}"))


def test_a_controller_that_ends_its_run_is_not_run_again(own, tmp_path):
    """Not for the run without the fault either, which it might hang; the folder is whole."""
    (own / "ends.py").write_text(
        "class Ends:\n    steps = 0\n    def __init__(self, setup): pass\n"
        "    def reset(self, reference): pass\n    def step(self, inputs):\n"
        "        Ends.steps += 1\n        assert Ends.steps < 400\n        return 0.0, 0.0\n"
    )
    done = execute(of("ends:Ends"), tmp_path / "run", StopRequest(), Options(report=False))
    assert done is not None
    assert "step failed at 0.399 s: AssertionError" in str(done.failure)
    assert sys.modules["ends"].Ends.steps == 400
    assert done.metrics["deviation_peak_after_fault_mps2"] is None
    assert can_rig.load(tmp_path / "run").signals.index[-1] == pytest.approx(0.399, abs=2e-3)


def test_a_controller_that_fails_without_the_fault_keeps_its_run(own, tmp_path):
    """As one that failed within the last second of real time: all ticks are in the log."""
    (own / "once.py").write_text(
        "class Once:\n    steps = 0\n    def __init__(self, setup): pass\n"
        "    def reset(self, reference): pass\n    def step(self, inputs):\n"
        "        Once.steps += 1\n        assert Once.steps <= 600\n        return 0.0, 0.0\n"
    )
    done = execute(of("once:Once"), tmp_path / "run", StopRequest(), Options(report=False))
    assert done is not None and done.failure is None
    assert done.metrics["deviation_peak_after_fault_mps2"] is None
    assert can_rig.load(tmp_path / "run").summary["ticks"] == 600


SLOW = """
import time
class Slow:
    def __init__(self, setup): pass
    def reset(self, reference): pass
    def step(self, inputs):
        time.sleep(2e-4)
        return 0.0, 0.0
"""


def test_the_check_waits_for_the_next_answer_alone(own):
    (own / "slow.py").write_text(SLOW)
    refuse_from_outside(of("slow:Slow"), False, StopRequest(), silence_s=1.0)


def test_a_check_from_outside_refuses_as_any_check():
    unstable = of("filters", "controller.c.num=[-20.0]", "controller.c.den=[1.0, 0.0]")
    with pytest.raises(ScenarioError, match=r"^scenario default: .* unstable \(healthy\)"):
        refuse_from_outside(unstable, False, StopRequest(), silence_s=60.0)


def test_limits_and_missing_inputs_are_the_nodes(own):
    (own / "much.py").write_text(
        "class Much:\n    held = 0\n    def __init__(self, setup): pass\n"
        "    def reset(self, reference): pass\n    def hold(self): Much.held += 1\n"
        "    def step(self, inputs): return 1e9, -1e9\n"
    )
    limits = ["limits.torque_nm=100", "limits.torque_rate_nm_per_s=1000",
              "limits.force_difference_n=500"]  # fmt: skip
    peer = peer_of(of("much:Much", *limits))
    answers = [peer.step(Inputs(1.0, 0.0)) for _ in range(200)]
    assert [round(each.command_1) for each in answers[:3]] == [1, 2, 3]
    assert answers[-1][:2] == (100.0, -500.0)
    held = peer.step(Inputs(np.nan, 0.0))
    assert held[:2] == (100.0, -500.0)
    assert held.mode == 2
    assert sys.modules["much"].Much.held == 1


def test_other_ways_to_run_belong_to_the_law():
    with pytest.raises(ExportError, match="--controller c: must be left out"):
        controller_of("c", of("pi"))
    pi = "controller.kind=pi"
    ours: list[Callable[[], object]] = [
        lambda: application(of("pi")),
        lambda: tune(of("pi"), []),
        lambda: compare_scenario("thesis-step", [pi]),
        lambda: replay_drive(source_of(CAR / "car.log.gz", str(CAR / "car.toml"), [pi])),
    ]
    for call in ours:
        with pytest.raises(ScenarioError, match=r"controller.kind = 'pi': must be 'ours' for "):
            call()


# --- filters -------------------------------------------------------------------------------------

RNG = np.random.default_rng(0)
INPUTS: FloatArray = RNG.standard_normal((400, 2))


def answers_of(law: FiltersLaw) -> FloatArray:
    return np.array([law.step(Inputs(*row))[:3] for row in INPUTS.tolist()])


def test_filters_answer_as_scipys_in_series():
    """u1 = C (r - y), then d̂ = F1 u1 + F2 y, then u2 = F̂ d̂, by ``lfilter`` one after another."""
    tick_s = 0.001
    named = {
        "c": ([20.0, 100.0], [1.0, 0.0]), "f1_u1": ([0.02], [1e-3, 0.1, 1.0]),
        "f2": ([-1.0], [0.02, 1.0]), "f_hat": ([3.0, 1000.0], [0.01, 1.0]),
    }  # fmt: skip
    law = FiltersLaw({name: discretise(each, tick_s) for name, each in named.items()})
    z = {name: signal.bilinear(*each, fs=1.0 / tick_s) for name, each in named.items()}
    r, y = INPUTS.T
    u1 = signal.lfilter(*z["c"], r - y)
    d = signal.lfilter(*z["f1_u1"], u1) + signal.lfilter(*z["f2"], y)
    expected = np.column_stack([u1, signal.lfilter(*z["f_hat"], d), d])
    answers = answers_of(law)
    assert np.abs(answers - expected).max(axis=0) == pytest.approx(
        0.0, abs=1e-9 * np.abs(expected).max()
    )


def test_a_loop_within_a_tick_is_solved_once():
    """u2 = F̂ d̂ and d̂ = y + F1 u2, both without delay: d̂ = y/(1 - f g)."""
    law = FiltersLaw({
        "f2": discretise(([1.0], [1.0]), 0.001), "f1_u2": discretise(([0.5], [1.0]), 0.001),
        "f_hat": discretise(([1.2], [1.0]), 0.001),
    })  # fmt: skip
    assert answers_of(law)[:, 2] == pytest.approx(INPUTS[:, 1] / (1.0 - 0.6))
    with pytest.raises(ValueError, match="a loop without delay"):
        FiltersLaw({
            "f1_u2": discretise(([0.5], [1.0]), 0.001), "f_hat": discretise(([2.0], [1.0]), 0.001),
        })  # fmt: skip


FORMS = {
    "num, den in z": ["controller.c.num=[0.5, 0.1]", "controller.c.den=[1.0, -0.6]"],
    "poles in z": [
        "controller.c.zeros=[-0.2]",
        "controller.c.poles=[0.6]",
        "controller.c.gain=0.5",
    ],
    "sos": ["controller.c.sos=[[0.5, 0.1, 0.0, 1.0, -0.6, 0.0]]"],
}


@pytest.mark.parametrize("form", FORMS)
def test_one_filter_in_z_in_every_form(form):
    domain = [] if form == "sos" else ["controller.c.domain=z"]
    peer = peer_of(of("filters", *FORMS[form], *domain))
    u1 = [peer.step(Inputs(r, 0.0)).command_1 for r in INPUTS[:, 0].tolist()]
    assert u1 == pytest.approx(signal.lfilter([0.5, 0.1], [1.0, -0.6], INPUTS[:, 0]))


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        (["controller.c.num=[1.0, 0.0, 0.0]", "controller.c.den=[1.0, 1.0]"], "controller.c: "),
        (["controller.c.num=[1.0]"], "den: must be given beside num"),
        (["controller.c.sos=[[1.0]]"], r"sos\[0\]: has 1 numbers: must have 6"),
        ([], "a filter must be set"),
    ],
)
def test_a_filter_that_is_none_is_refused(settings, line):
    with pytest.raises(RigError, match=line):
        refuse(of("filters", *settings))


# --- margins -------------------------------------------------------------------------------------


def test_our_own_law_read_off_its_answers_has_its_matrices_response():
    """The same law twice: by its memories, and by its impulse response alone."""
    scenario = load("default", ["limits.torque_nm=1e6", "limits.force_difference_n=1e6"])
    table = controller_table(scenario, None)

    def respond(inputs: FloatArray) -> FloatArray:
        firmware = Firmware(table)
        firmware.reset(0.0)
        return np.array([firmware.step(r, y)[:3] for y, r in inputs.tolist()])

    found, exact = read_off(respond, scenario.latency_ticks), linear_controller(table)
    for omega in (0.1, 1.0, 10.0, 100.0, 1000.0):
        z = np.exp(1j * omega * scenario.tick_s)
        one, other = (
            law.c @ np.linalg.solve(z * np.eye(len(law.a)) - law.a, law.b) + law.d
            for law in (found, exact)
        )
        assert np.abs(one - other).max(axis=1) == pytest.approx(
            0.0, abs=1e-4 * float(np.abs(other).max())
        )


def test_the_margins_of_filters_are_those_of_their_transfer_functions():
    scenario = load("default", [*FILTERS, "budget.box=0"])
    law = linear_law_of(scenario)
    c = discretise(([20.0, 100.0], [1.0, 0.0]), scenario.tick_s)
    for omega in (0.5, 5.0, 50.0):
        z = np.exp(1j * omega * scenario.tick_s)
        response = law.c @ np.linalg.solve(z * np.eye(len(law.a)) - law.a, law.b) + law.d
        assert response[0, 1] == pytest.approx(complex(c.frequency_response(omega)), rel=1e-4)
        assert response[0, 0] == pytest.approx(-response[0, 1], rel=1e-6)


def test_a_controller_that_is_not_linear_has_no_margins(own):
    (own / "relay.py").write_text(
        "class Relay:\n    def __init__(self, setup): pass\n    def reset(self, reference): pass\n"
        "    def step(self, inputs): return (10.0 if inputs.reference > 0 else -10.0), 0.0\n"
    )
    with pytest.raises(
        RigError, match="has no margins: its answers around rest grow without end or are not linear"
    ):
        check_stability(of("relay:Relay"))
    refuse(of("relay:Relay"))  # runs all the same


def test_a_controller_that_computes_with_its_limits_has_margins(own):
    """Commands as shares of their limits, as of an MPC: check and run tell the same limits."""
    (own / "shares.py").write_text(
        "class Shares:\n    def __init__(self, setup): self.limits = setup.limits\n"
        "    def reset(self, reference): pass\n"
        "    def step(self, inputs):\n        one, two = self.limits\n"
        "        error = inputs.reference - inputs.measurement\n"
        "        return one * (20.0 / one * error), 0.0\n"
    )
    (own / "plain.py").write_text(
        "def plain(inputs): return 20.0 * (inputs.reference - inputs.measurement), 0.0\n"
    )
    found, expected = (
        check_stability(of(kind, "budget.box=0")) for kind in ("shares:Shares", "plain:plain")
    )
    assert found.healthy.spectral_radius == pytest.approx(expected.healthy.spectral_radius)
    assert [str(each) for each in found.findings] == [str(each) for each in expected.findings]


def test_the_steps_of_a_sensor_are_not_too_coarse_for_a_loop_that_a_loss_opens():
    """Noise walks an open integrator away without end, whatever the step of the frame."""
    margins = check_stability(of("pi", "budget.box=0"))
    assert np.isinf(margins.faulted.noise_to_command_1)
    assert list(margins.network_notes) == []


def test_an_unstable_loop_is_refused():
    settings = ["controller.c.num=[-500.0]", "controller.c.den=[1.0]"]
    with pytest.raises(RigError, match=r"controller\.kind = 'filters': unstable \(healthy\)"):
        refuse(of("filters", *settings))


# --- a C library ---------------------------------------------------------------------------------

EXAMPLE = Path(__file__).parents[3] / "docs" / "examples" / "pi.c"
CC = shutil.which("cc")
needs_compiler = pytest.mark.skipif(CC is None, reason="no C compiler")


def example_of_the_page() -> str:
    page = (EXAMPLE.parents[1] / "controllers.md").read_text("utf-8")
    return page.split("```python\n")[1].split("```")[0]


def library(folder: Path, text: str, name: str = "own") -> Path:
    source, made = folder / f"{name}.c", folder / f"{name}.so"
    source.write_text(text)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-O2"]
    subprocess.run([str(CC), *flags, f"-I{HEADER.parent}", "-o", made, source], check=True)
    return made


@needs_compiler
def test_the_example_in_c_is_the_example_in_python(tmp_path, own):
    (own / "mypi.py").write_text(example_of_the_page())
    numbers = ["controller.parameters.kp=20.0", "controller.parameters.ki=100.0"]
    made = library(tmp_path, EXAMPLE.read_text())
    in_c = logged(of(f"c:{made}", *numbers), tmp_path / "c")
    assert in_c == logged(of("mypi:PI", *numbers), tmp_path / "python")


@needs_compiler
def test_a_library_that_is_compiled_again_runs_as_it_is_now(tmp_path):
    text = EXAMPLE.read_text()
    other = text.replace("20.0, 100.0", "60.0, 100.0")
    assert other != text
    made = library(tmp_path, text)
    first = logged(of(f"c:{made}"), tmp_path / "first")
    library(tmp_path, other)
    assert logged(of(f"c:{made}"), tmp_path / "other") != first
    library(tmp_path, text)
    assert logged(of(f"c:{made}"), tmp_path / "again") == first


@needs_compiler
@pytest.mark.parametrize(
    ("change", "line"),
    [
        (("controller_free", "other_free"), "controller_free missing"),
        (("return 1;", "return 2;"), r"controller_abi\(\) is 2: must be 1"),
        (("return made;", "return 0;"), "controller_new answers NULL"),
    ],
)
def test_a_library_that_is_none_is_refused(change, line, tmp_path):
    text = EXAMPLE.read_text()
    assert change[0] in text
    text = text.replace(
        '#include "controller.h"', '#include "controller.h"\nvoid other_free(void *c);'
    )
    with pytest.raises(RigError, match=line):
        refuse(of(f"c:{library(tmp_path, text.replace(*change), 'bad')}"))


def test_a_file_that_is_no_library_is_refused(tmp_path):
    (tmp_path / "text.so").write_text("no library")
    with pytest.raises(RigError, match="must be a shared library, as of cc -shared"):
        refuse(of(f"c:{tmp_path / 'text.so'}"))


# --- an FMU --------------------------------------------------------------------------------------


def test_an_fmu_is_a_controller(tmp_path):
    """x' = -x + r - y, u1 = 10 x, as an FMU and by scipy's exact matrices of a held input."""
    if CC is None:
        pytest.skip("no C compiler")
    fmu = build(tmp_path / "law.fmu", 2, np.array([[-1.0]]), np.array([[1.0, -1.0]]), [10.0])
    names = {"reference": "u1", "measurement": "u2", "command_1": "y", "command_2": "y"}
    settings = [f'controller.variables.{key}="{name}"' for key, name in names.items()]
    peer = peer_of(of(f"fmu:{fmu}", *settings))
    x, decay = 0.0, float(np.exp(-1e-3))
    for row in INPUTS.tolist():
        r, y = row
        answer = peer.step(Inputs(r, y))
        x = decay * x + (1.0 - decay) * (r - y)
        assert answer[:2] == pytest.approx((10.0 * x, 10.0 * x), abs=1e-6)
        assert answer[2:] == (None, None, None, None)
    with pytest.raises(RigError, match=r"controller\.variables\.command_1 = 'none': the FMU has"):
        peer_of(of(f"fmu:{fmu}", *settings, 'controller.variables.command_1="none"'))
    with pytest.raises(RigError, match=r"controller\.variables\.reference: must be set"):
        peer_of(of(f"fmu:{fmu}"))
