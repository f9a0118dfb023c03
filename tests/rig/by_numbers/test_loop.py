"""The whole rig on plants by numbers, against python-control and scipy on their own."""

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from can_rig.assessment.stability import check_stability
from can_rig.assessment.tuning import search
from can_rig.assessment.tuning.candidate import Values, cars, parameter_ranges
from can_rig.plant.frameless import frameless
from can_rig.results.report import page as report
from can_rig.results.signals import read_signals
from can_rig.scenario.build import continuous_plant, network_of
from can_rig.scenario.loading import load
from can_rig.thesis.comparisons import compare_scenario
from firmware_model.law.status import FaultState
from tests.helpers import asked, record, succeeded
from tests.rig.by_numbers.plants import PLANTS, written


@pytest.mark.parametrize("name", PLANTS)
def test_a_run_is_what_scipy_makes_of_its_commands(tmp_path, name):
    """Both nodes, a bus, the loss at half time: the log's D* follows from its commands alone."""
    path = written(tmp_path, name)
    scenario = load(path, ["duration_s=10", "plant.sensor.noise_mps2=0"])
    log, summary, _ = record(tmp_path, "duration_s=10", "plant.sensor.noise_mps2=0", name=path)
    assert summary.ticks == scenario.ticks
    signals = read_signals(log, network_of(scenario), scenario.tick_s)
    commands = np.column_stack([signals.torque_nm, signals.force_difference_n])
    commands = np.vstack([np.zeros((scenario.latency_ticks, 2)), commands])[: scenario.ticks]
    lost = round(scenario.loss.at_s / scenario.tick_s)
    commands[lost:, 0] = 0.0
    plant = continuous_plant(scenario.plant)
    held = signal.cont2discrete((plant.a, plant.b, plant.c, np.zeros((1, 2))), scenario.tick_s)
    _, y, _ = signal.dlsim(held, commands)
    np.testing.assert_allclose(signals.dstar_mps2, y[:, 0], atol=2e-8 * max(1.0, np.abs(y).max()))
    confirmed = np.flatnonzero(signals.fault_state == FaultState.CONFIRMED)
    assert lost < confirmed[0] < lost + 2.0 / scenario.tick_s
    assert np.abs(signals.error_mps2[-10:]).max() < 0.1 * scenario.reference.amplitude_mps2
    trace = frameless(scenario)
    np.testing.assert_allclose(signals.dstar_mps2, trace.measurement, atol=6e-9)  # half an LSB


def test_a_log_is_replayed_bit_for_bit_and_drawn_with_its_own_names(tmp_path):
    path = written(tmp_path, "aircraft")
    done = succeeded("run", path, "--out", tmp_path / "run", "--set", "duration_s=8")
    assert "|elevator|, peak" in done.stdout and " rad\n" in done.stdout.replace("  ", "")
    again = asked("replay", tmp_path / "run")
    assert again.returncode == 0 and "identical, bit for bit" in again.stdout
    scenario = load(path, ["duration_s=8"])
    network = network_of(scenario)
    signals = read_signals(tmp_path / "run" / "bus.log", network, scenario.tick_s)
    page = report.page(scenario, network, signals)
    labels = [axis.get_ylabel() for axis in page.axes[:5]]
    assert labels == [
        "pitch rate\nin rad/s", "error, rms\nin rad/s", "elevator\nin rad", "canard\nin rad",
        "fault estimate\nin rad/s",
    ]  # fmt: skip
    assert "elevator lost at 5 s" in page.get_suptitle()


@pytest.mark.parametrize(("name", "first"), [("column", "reflux"), ("aircraft", "elevator")])
def test_check_speaks_of_the_plant(tmp_path, name, first):
    done = succeeded("check", written(tmp_path, name))
    words = " ".join(done.stdout.split())
    assert f"the loss of {first} in this drive is confirmed" in words
    for word in ("torque", "X_diff", "D*", "m/s²", "car"):
        assert word not in words


@pytest.mark.parametrize(("limit", "said"), [(0.011, True), (0.012, False)])
def test_check_says_where_the_second_input_cannot_hold_the_reference(tmp_path, limit, said):
    """A boilup of 1/86.4 = 0.01157 mol/s holds 1 %."""
    path = written(tmp_path, "column")
    done = asked("check", path, "--set", f"limits.force_difference_n={limit}")
    words = " ".join(done.stdout.split())
    short = (
        "control authority: NOT ENOUGH: without reflux boilup holds purity up to 0.95 % at its "
        "limit of 0.011 mol/s, and |r| is up to 1 %"
    )
    assert (short in words) == said
    assert ("NOT ENOUGH" in words) == said


def test_tune_finds_the_least_peak_for_other_plants_of_the_box(tmp_path, monkeypatch):
    some: Sequence[Values] = [(0.01, 4, 0.056, 3), (0.047, 3, 0.1, 3), (0.0047, 3, 0.039, 2)]
    monkeypatch.setattr(search, "grid", lambda scenario: some)
    path = written(tmp_path, "two-masses")
    done = succeeded("tune", path, "--json", "--out", tmp_path / "tuning")
    values = json.loads(done.stdout)
    assert values["cars"] == 1 + 2**3
    assert "with force 1 lost, for the nominal plant and 8 around it" in values["why"]
    chosen = values["options"].split()[1::2]
    assert check_stability(load(path, [word for word in chosen if "=" in word])).linear_stable
    for setting, hint in (
        ("mass=8..12", "as in plant.gain_1=0.8..1.2"),
        ("speed_mps=8..12", "did you mean speed?"),
    ):
        bad = asked("tune", path, "--force", "--box-set", f"plant.{setting}")
        assert f"must be plant.KEY=LOW..HIGH, {hint}" in bad.stderr


def test_the_box_of_a_slow_plant_is_driven_for_as_long_as_it_takes(tmp_path):
    column = load(written(tmp_path, "column"))
    some = cars(column.model, parameter_ranges(column.model, 0.2))
    assert [car.label for car in some][:2] == [
        "the nominal car", "gain_1 = 0.8, gain_2 = 0.8, speed_1 = 0.8, speed_2 = 0.8",
    ]  # fmt: skip
    wrong = replace(column.plant, g2=column.plant.g2.scaled(-1.0, 1.0))  # boilup the wrong way
    found = check_stability(replace(column, plant=wrong))
    assert not found.stable


def test_the_figures_of_a_scenario_are_those_of_its_continuous_loop(tmp_path):
    """Theorem 2.3.2 on any plant: d̂ is 0 while healthy and G1 u1 when channel 1 is lost."""
    path = written(tmp_path, "two-masses")
    fine = ["design.compensation=always", "design.estimator=zoh", "tick_s=0.002", "latency_ticks=0",
            "duration_s=10"]  # fmt: skip
    healthy, lost, loss = compare_scenario(path, fine)
    assert healthy.distance(healthy.curves[0]) < 1e-9
    estimate, channel = lost.curves
    np.testing.assert_allclose(estimate.sampled, channel.sampled, atol=1e-6)
    assert loss.distance_after_loss(loss.curves[0]) < 0.02
    succeeded("figures", path, "--out", tmp_path / "figures", "--set", "duration_s=6")
    assert {each.name for each in (tmp_path / "figures").iterdir()} == {
        "fig-healthy.png", "fig-lost.png", "fig-loss.png",
    }  # fmt: skip
