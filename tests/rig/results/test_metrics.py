"""The numbers of a run: windows by hand, the rig's own fault-free run, the continuous loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from can_rig.assessment.resolve import load
from can_rig.assessment.stability import check_stability
from can_rig.nodes.runner import run_in_process
from can_rig.nodes.watchdog import StopRequest
from can_rig.results.counterfactual import fault_free
from can_rig.results.metrics import Metrics, metrics, rows, windows
from can_rig.results.signals import Signals, read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario
from can_rig.thesis.continuous import solve
from firmware_model.design.plants import steer_by_wire

LSB_MPS2 = 1e-8
Run = Callable[..., tuple[Scenario, Signals]]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    def rig(name: str, *settings: str) -> tuple[Scenario, Signals]:
        scenario, log = load(name, settings), tmp_path / "bus.log"
        run_in_process(scenario, "local:metrics", log, StopRequest(), lambda tick: None)
        return scenario, read_signals(log, network_of(scenario), scenario.tick_s)

    return rig


def quiet(scenario: Scenario, **changed: np.ndarray) -> Signals:
    """A run in which nothing moves, but for the columns given."""
    zero = np.zeros(scenario.ticks)
    names = [name for name in Signals.__dataclass_fields__ if name != "time_s"]
    columns = {name: zero.copy() for name in names} | changed
    return Signals(np.arange(scenario.ticks) * scenario.tick_s, **columns)


def spans(scenario: Scenario) -> dict[str, tuple[float, float] | None]:
    """First and last time of every window, s."""
    signals = quiet(scenario)
    found = {}
    for name, mask in vars(windows(scenario, signals)).items():
        inside = signals.time_s[mask]
        found[name] = (round(inside[0], 6), round(inside[-1], 6)) if len(inside) else None
    return found


def test_windows_of_a_lasting_fault() -> None:
    assert spans(load("thesis-step", ["tick_s=0.01"])) == {
        "before": (0.0, 9.99),
        "after": (10.0, 19.99),
        "lost": (10.0, 19.99),
        "settled_before": (7.99, 9.99),
        "settled_after": (17.99, 19.99),
    }


def test_windows_of_a_passing_fault_settle_after_it_has_passed() -> None:
    found = spans(load("thesis-step", ["tick_s=0.01", "fault.for_s=9"]))
    assert found["lost"] == (10.0, 18.99)
    assert found["after"] == (10.0, 19.99)
    # Half of the second that is left: its first half is the transient of the return.
    assert found["settled_after"] == (19.5, 19.99)


def test_two_periods_of_a_slow_reference_count_as_settled() -> None:
    settings = ["tick_s=0.01", "reference.frequency_rad_per_s=3.141592653589793"]
    assert spans(load("thesis-sine", settings))["settled_after"] == (15.99, 19.99)


@pytest.mark.parametrize("settings", [["fault.kind=none"], ["duration_s=2.0"]])
def test_windows_without_a_fault(settings: list[str]) -> None:
    found = spans(load("thesis-step", ["tick_s=0.01", *settings]))
    assert found["after"] is found["lost"] is found["settled_after"] is None
    assert found["before"] is not None


def test_the_fault_is_lost_at_the_ticks_at_which_the_nodes_lose_it() -> None:
    """Binary fractions of a second must not shift it by a tick."""
    for at in range(1, 1500, 7):
        scenario = load("thesis-step", ["duration_s=2.0", f"fault.at_s={at / 1000}"])
        lost = windows(scenario, quiet(scenario)).lost
        active = [scenario.fault.active(k * scenario.tick_ns) for k in range(scenario.ticks)]
        assert lost.tolist() == active


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("thesis-step", []),
        ("thesis-sine", ["noise.dstar_rms_mps2=0.005", "seed=7"]),
        ("chapter-2", []),
        ("nonlinear-car", ["noise.dstar_rms_mps2=0.005"]),
        ("thesis-sine", ["latency_ticks=1", "design.tau_s=0.01", "design.tau_q_s=0.02"]),
        ("thesis-step", ["plant.mass_kg=1500", "model.mass_kg=1400", "limits.torque_nm=500"]),
    ],
)
def test_fault_free_is_the_rig_s_own_run_without_the_fault(
    run: Run, name: str, settings: list[str]
) -> None:
    """Same plant, limits, noise and latency, to the last bit of D*."""
    short = ["duration_s=0.3", "fault.at_s=0.1", *settings]
    _, signals = run(name, *short, "fault.kind=none")
    found = fault_free(load(name, short), signals)
    np.testing.assert_array_equal(found.dstar_mps2, signals.dstar_mps2)
    np.testing.assert_array_equal(found.force_difference_n, signals.force_difference_n)


FAILING = """
class Failing:
    def __init__(self, settings): self.reset()
    def reset(self): self.calls, self.dstar_mps2 = 0, 0.0
    def advance(self, dt_s, torque_nm, force_difference_n):
        self.calls += 1
        if self.calls > 70: raise RuntimeError("it broke")
        self.dstar_mps2 += (0.02 * torque_nm - self.dstar_mps2) * dt_s
        return self.dstar_mps2
"""


def test_fault_free_ends_where_a_plant_fails_by_itself(tmp_path: Path) -> None:
    (tmp_path / "breaking_car.py").write_text(FAILING)
    kind = "plant.kind=breaking_car:Failing"
    scenario = load("thesis-step", ["duration_s=0.1", "fault.at_s=0.05", kind])
    broken = fault_free(scenario, quiet(scenario))
    assert np.isfinite(broken.dstar_mps2[:71]).all()
    assert np.isnan(broken.dstar_mps2[71:]).all()
    assert np.isnan(broken.force_difference_n[71:]).all()
    assert np.abs(broken.dstar_mps2[:71]).max() > 0.0
    # Where there is nothing to compare with there is no number.
    assert metrics(scenario, quiet(scenario))["deviation_settled_after_fault_mps2"] is None


def test_fault_free_of_a_log_that_starts_late() -> None:
    scenario = load("thesis-sine", ["duration_s=0.2"])
    signals = quiet(scenario)
    late = Signals(*(getattr(signals, name)[150:] for name in Signals.__dataclass_fields__))
    np.testing.assert_array_equal(
        fault_free(scenario, late).dstar_mps2, fault_free(scenario, signals).dstar_mps2[150:]
    )
    empty = Signals(*(getattr(signals, name)[:0] for name in Signals.__dataclass_fields__))
    assert fault_free(scenario, empty).dstar_mps2.shape == (0,)


@pytest.mark.parametrize(("name", "within"), [("thesis-step", 0.08), ("chapter-2", 0.01)])
def test_deviation_is_that_of_the_continuous_loop(run: Run, name: str, within: float) -> None:
    scenario, signals = run(name, "duration_s=3.0", "fault.at_s=1.5")
    lost, kept = solve(scenario), solve(scenario.healthy)
    expected = np.abs(lost.measurement - kept.measurement).max()
    values = metrics(scenario, signals)
    assert values["deviation_peak_after_fault_mps2"] == pytest.approx(expected, rel=within)
    assert (values["error_peak_after_fault_mps2"] is None) == (name == "chapter-2")


def test_a_fault_where_nothing_acts_changes_nothing(run: Run) -> None:
    """Channel 2 idles in a settled healthy loop, so losing it is not seen."""
    scenario, signals = run(
        "thesis-step", "fault.channel=force-difference", "fault.at_s=1.5", "duration_s=2.0"
    )
    values = metrics(scenario, signals)
    deviation = values["deviation_peak_after_fault_mps2"]
    assert deviation is not None and deviation < 1e-6
    assert values["detection_delay_s"] is None
    assert ("loss confirmed after", "never") in rows(values, network_of(load("thesis-step")))


@pytest.mark.parametrize(
    ("settings", "first", "last", "missed"),
    [
        ([], 0, 0, None),
        ([], 0, 1000, None),  # not any more when it was lost
        ([], 1500, 2000, None),  # only when it had come back
        ([], 1200, 1201, True),
        (["latency_ticks=2"], 0, 998, None),
        (["latency_ticks=2"], 0, 999, True),  # on its way when the actuator died
        (["fault.kind=frames-missing"], 0, 999, None),
        (["fault.kind=frames-missing"], 0, 1000, True),  # the last that was heard
        (["fault.channel=torque"], 0, 0, True),
    ],
)
def test_a_lost_force_difference_is_missed_only_where_it_acted(
    settings: list[str], first: int, last: int, missed: bool | None
) -> None:
    lost = ["fault.channel=force-difference", "fault.at_s=1.0", "fault.for_s=0.5"]
    scenario = load("thesis-step", ["duration_s=2.0", *lost, *settings])
    force = np.zeros(scenario.ticks)
    force[first:last] = -5.0
    if scenario.fault.kind == "frames-missing":
        force[1000:1500] = np.nan
    values = metrics(scenario, quiet(scenario, force_difference_n=force))
    assert values["missed_detection"] is missed


def test_what_the_force_difference_can_carry_is_said_where_the_torque_is_lost() -> None:
    keys = ("dstar_carried_mps2", "force_difference_needed_n", "force_difference_available_n")
    for settings, there in ((["fault.channel=torque"], True), (["fault.kind=none"], False),
                            (["fault.channel=force-difference"], False),
                            (["fault.kind=sensor-biased"], False)):  # fmt: skip
        scenario = load("default", ["tick_s=0.01", *settings])
        values = metrics(scenario, quiet(scenario))
        assert [values[key] is not None for key in keys] == [there] * 3


@pytest.mark.parametrize("bias", [0.1, -0.04])
def test_a_biased_sensor_leaves_the_error_of_the_car(run: Run, bias: float) -> None:
    """The loop holds the measured D*, so the car settles off by the bias, and comes back."""
    biased = ["fault.kind=sensor-biased", f"fault.bias_mps2={bias}", "fault.at_s=1.5"]
    for name in ("default", "thesis-step"):
        scenario, signals = run(name, *biased, "duration_s=5.0")
        assert np.abs(signals.error_mps2[-1000:]).max() < 1e-3 * abs(bias)  # as measured
        values = metrics(scenario, signals)
        for key in ("error_settled_after_fault_mps2", "deviation_settled_after_fault_mps2"):
            assert values[key] == pytest.approx(abs(bias), rel=1e-2)
        assert values["error_before_fault_mps2"] == pytest.approx(0.0, abs=1e-3)
    scenario, signals = run("default", *biased, "fault.for_s=1.0", "duration_s=5.0")
    values = metrics(scenario, signals)
    for key in ("error_settled_after_fault_mps2", "deviation_settled_after_fault_mps2"):
        assert values[key] == pytest.approx(0.0, abs=0.1 * abs(bias))


def test_the_tick_at_which_a_bias_comes_is_no_jump_of_the_car(run: Run) -> None:
    scenario, signals = run(
        "default", "fault.kind=sensor-biased", "fault.at_s=0.05", "duration_s=0.051"
    )
    peak = metrics(scenario, signals)["deviation_peak_after_fault_mps2"]
    assert signals.dstar_mps2[-1] - signals.dstar_mps2[-2] > 0.09
    assert peak is not None and peak < 20 * LSB_MPS2


def test_a_passing_fault_is_over_at_the_end(run: Run) -> None:
    scenario, signals = run("thesis-step", "fault.at_s=1.0", "fault.for_s=0.5", "duration_s=6.0")
    values = metrics(scenario, signals)
    assert values["fault_estimate_peak_while_lost_mps2"] == pytest.approx(1.0, rel=0.1)
    settled = values["fault_estimate_settled_mps2"]
    assert settled is not None and settled < 1e-3
    force = values["force_difference_settled_n"]
    assert force is not None and force < 10.0


CLEAR, SUSPECTED, CONFIRMED, CANNOT_TELL = 0.0, 1.0, 2.0, 3.0


def states(scenario: Scenario, *changes: tuple[int, float]) -> np.ndarray:
    """The fault state of every tick: CLEAR, and from each tick named what it changes to."""
    state = np.full(scenario.ticks, CLEAR)
    for tick, value in changes:
        state[tick:] = value
    return state


def test_the_decision_is_what_the_status_frames_say() -> None:
    scenario = load("thesis-step", ["duration_s=3.6", "fault.at_s=1.0", "fault.for_s=1.0"])
    state = states(
        scenario,
        (100, CONFIRMED),  # a false alarm before the loss detects nothing
        (200, CLEAR),
        (300, SUSPECTED),  # is none
        (301, CLEAR),
        (1100, SUSPECTED),
        (1234, CONFIRMED),  # stays so after the channel has come back: no other alarm
        (2500, CLEAR),
        (2600, CONFIRMED),  # another one
    )
    values = metrics(scenario, quiet(scenario, fault_state=state))
    assert values["suspected_after_s"] == 0.1
    assert values["detection_delay_s"] == 0.234
    assert values["missed_detection"] is False
    assert values["false_alarms"] == 2
    assert values["false_alarms_per_hour"] == pytest.approx(2 * 3600.0 / 2.6)


def test_a_loss_that_is_never_confirmed_is_missed_unless_it_could_not_show() -> None:
    scenario = load("thesis-step", ["duration_s=2.0", "fault.at_s=1.0"])
    for state, missed in ((SUSPECTED, True), (CLEAR, True), (CANNOT_TELL, None)):
        signals = quiet(scenario, fault_state=states(scenario, (0, state)))
        values = metrics(scenario, signals)
        assert values["missed_detection"] is missed
        assert values["detection_delay_s"] is None
    nothing_lost = metrics(scenario.healthy, quiet(scenario))
    assert nothing_lost["missed_detection"] is None
    assert nothing_lost["false_alarms_per_hour"] == 0.0


@pytest.mark.parametrize("latency", [0, 1, 2, 5])
@pytest.mark.parametrize("left", [0.0, 0.4])
def test_unavoidable_is_what_a_loss_does_before_anything_can_answer(
    latency: int, left: float
) -> None:
    """A step of the torque, missing in part for n + 1 ticks: scipy's step response of G1."""
    settings = [f"latency_ticks={latency}", f"fault.left={left}", "duration_s=11.0"]
    scenario = load("thesis-step", [*settings, "design.tau_s=0.02", "design.tau_q_s=0.02"])
    torque = 40.0
    signals = quiet(scenario, torque_nm=np.full(scenario.ticks, torque))
    g1 = steer_by_wire().g1
    times = np.linspace(0.0, (latency + 1) * scenario.tick_s, 2001)
    _, step = signal.step(signal.ZerosPolesGain(g1.zeros, g1.poles, g1.gain), T=times)
    found = metrics(scenario, signals)["unavoidable_deviation_mps2"]
    assert found == pytest.approx((1.0 - left) * torque * step[-1], rel=1e-6)
    # trap 11
    short = 0.5 * g1.gain * torque * ((latency + 1) * scenario.tick_s) ** 2
    assert found == pytest.approx((1.0 - left) * short, rel=0.05)


def test_there_is_nothing_unavoidable_where_no_actuator_dies_in_the_log() -> None:
    for settings in (["fault.kind=none"], ["fault.kind=frames-missing"], ["duration_s=2.0"]):
        scenario = load("thesis-step", ["tick_s=0.01", *settings])
        assert metrics(scenario, quiet(scenario))["unavoidable_deviation_mps2"] is None


def test_noise_in_the_commands_is_that_of_the_exact_covariance(run: Run) -> None:
    scenario, signals = run("noisy", "duration_s=10.0", "fault.kind=none")
    expected = check_stability(scenario).healthy.noise_to_command_2 * scenario.noise.dstar_rms_mps2
    found = metrics(scenario, signals)["force_difference_noise_rms_n"]
    assert found == pytest.approx(expected, rel=0.15)  # 2 s of noise that lasts for some ms


def test_integral_of_the_error_counts_from_the_loss_on() -> None:
    scenario = load("thesis-step", ["duration_s=2.0", "fault.at_s=1.0"])
    reference = np.zeros(scenario.ticks)
    reference[900:1100] = -0.5
    values = metrics(scenario, quiet(scenario, reference_mps2=reference))
    assert values["error_integral_after_fault_mps"] == pytest.approx(0.5 * 0.1)


def test_peaks_belong_to_their_windows() -> None:
    settings = ["tick_s=0.01", "fault.for_s=5"]
    scenario = load("thesis-step", settings)
    reference = np.zeros(scenario.ticks)
    for tick, error in (
        (100, 9.0),
        (990, 1.0),
        (1000, -7.0),
        (1499, 2.0),
        (1500, 8.0),
        (1990, 3.0),
    ):
        reference[tick] = error
    values = metrics(scenario, quiet(scenario, reference_mps2=reference))
    assert values["error_before_fault_mps2"] == 1.0
    assert values["error_peak_while_lost_mps2"] == 7.0
    assert values["error_peak_after_fault_mps2"] == 8.0
    assert values["error_settled_after_fault_mps2"] == 3.0


def labels(scenario: Scenario, values: Metrics) -> str:
    network = network_of(load("thesis-step"))
    return "\n".join(f"{label}: {text}" for label, text in rows(values, network))


def test_rows_say_only_what_the_run_has() -> None:
    scenario = load("thesis-step", ["tick_s=0.01"])
    closed = labels(scenario, metrics(scenario, quiet(scenario)))
    assert "|error| after the fault, peak: 0 m/s²" in closed
    assert "deviation" in closed and "never" in closed
    healthy = replace(scenario, fault=replace(scenario.fault, kind="none"))
    without = labels(healthy, metrics(healthy, quiet(healthy)))
    assert "|error|, settled: 0 m/s²" in without
    assert not any(word in without for word in ("after", "before", "deviation", "never", "None"))
    other = load("chapter-2", ["tick_s=0.01"])
    opened = labels(other, metrics(other, quiet(other)))
    assert "error" not in opened and "deviation" in opened


def test_a_run_without_a_tick_has_no_numbers() -> None:
    scenario = load("thesis-step")
    empty = Signals(*(np.empty(0) for _ in Signals.__dataclass_fields__))
    values = metrics(scenario, empty)
    assert set(values.values()) == {None}
    assert rows(values, network_of(load("thesis-step"))) == []


def test_every_key_says_its_unit() -> None:
    scenario = load("thesis-step", ["tick_s=0.01"])
    for key in metrics(scenario, quiet(scenario)):
        plain = {"deviation_over_unavoidable", "missed_detection", "false_alarms"}
        assert key.endswith(("_mps2", "_mps", "_s", "_nm", "_n", "_per_hour")) or key in plain
