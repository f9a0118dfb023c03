"""Real time for real, for a few seconds: nothing here depends on how fast the machine is."""

import json
import signal

import numpy as np
import pytest

from can_rig.results.signals import Signals, read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from tests.helpers import asked, refused, start
from tests.processes import wait_for
from tests.rig.nodes.running import LONG, alive, lines_of, running, summary_of

pytestmark = pytest.mark.reports


def signals_of(log) -> Signals:
    return read_signals(log, network_of(load("ideal")), 0.001)


def folder_is_complete(folder, outcome):
    summary = summary_of(folder, outcome)
    assert "realtime" in summary
    assert len(signals_of(folder / "bus.log")) > 0
    return summary


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Two seconds of the default scenario, the motor lost after one."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    arguments = ["--set", "duration_s=2", "--set", "fault.at_s=1", "--out", folder]
    return asked("run", "ideal", "--realtime", *arguments), folder


def test_every_tick_is_in_the_log_or_counted_as_skipped(finished):
    done, folder = finished
    assert done.returncode == 0, done.stderr
    summary = folder_is_complete(folder, "complete")
    signals = signals_of(folder / "bus.log")
    assert len(signals) == summary["ticks"] == 2000
    there = int(np.isfinite(signals.dstar_mps2).sum())
    assert there + summary["realtime"]["skipped_ticks"] == 2000
    answered = np.isfinite(signals.torque_nm)
    assert (np.abs(signals.torque_nm[answered]) <= 400.0).all()
    unanswered = int((~answered[:1999]).sum())
    assert unanswered <= summary["realtime"]["unanswered_ticks"] + 1


def test_the_figures_are_in_run_json_and_in_the_table(finished):
    done, folder = finished
    summary = json.loads((folder / "run.json").read_text())
    assert summary["wall_s"] >= 1.999  # not faster than real time, whatever the machine does
    realtime = summary["realtime"]
    lateness = realtime["wake_up_lateness_us"]
    assert 0.0 <= lateness["p50"] <= lateness["p99"] <= lateness["p99.9"] <= lateness["max"]
    assert sum(lateness["counts"]) + realtime["skipped_ticks"] == 1999  # tick 0 has no deadline
    assert len(lateness["counts"]) == len(lateness["edges_us"])
    assert realtime["missed_deadlines"] >= realtime["skipped_ticks"]
    assert set(realtime["scheduling"]) == {"plant", "controller"}
    for words in ("wake-up lateness", "mean period, drift", "deadlines missed", "plant node"):
        assert words in done.stdout


def test_ctrl_c_ends_both_cleanly(tmp_path):
    with running(tmp_path, "ideal", "--realtime") as (process, log, nodes):
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=60)
        assert process.returncode == 130
        assert "Traceback" not in output + errors
        assert not any(map(alive, nodes.values()))
    summary = folder_is_complete(log.parent, "interrupted")
    assert len(signals_of(log)) == summary["ticks"]
    assert summary["realtime"]["wake_up_lateness_us"]["max"] > 0.0


def test_by_hand_a_killed_controller_is_started_again_and_takes_over(tmp_path):
    log = tmp_path / "bus.log"
    settings = [*LONG, "--set", "fault.kind=none", "--realtime"]
    common = ["ideal", *settings, "--bus", f"local:{tmp_path / 'bus'}"]
    first = second = start("controller", *common)
    plant = start("plant", *common, "--log", log)
    try:
        wait_for(lambda: lines_of(log) > 2500)
        first.kill()
        first.communicate()
        second = start("controller", *common)
        wait_for(lambda: restarted(log))
        for process in (second, plant):
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=60)
            assert process.returncode == 130, errors
    finally:
        for process in (first, plant, second):
            process.kill()
            process.communicate()
    # How long after and how smoothly: test_realtime's turned clock.
    signals = signals_of(log)
    assert first_after_the_outage(signals.fault_estimate_mps2) is not None  # while it listens
    assert first_after_the_outage(signals.torque_nm) is not None


def first_after_the_outage(values):
    """The first tick with a value after at least 300 without."""
    there = np.flatnonzero(np.isfinite(values))
    gaps = np.flatnonzero(np.diff(there) > 300)
    return int(there[gaps[0] + 1]) if len(gaps) else None


def restarted(log):
    """Whether commands have come again."""
    if b"110#" not in log.read_bytes()[-1000:]:
        return False  # no controller yet
    return first_after_the_outage(signals_of(log).torque_nm) is not None


@pytest.mark.parametrize("node", ["run", "plant", "controller"])
def test_a_latency_of_zero_is_refused_in_one_line(node, tmp_path):
    line = refused(node, "thesis-step", "--realtime")
    assert "latency_ticks = 0" in line
    assert "--set latency_ticks=1" in line
    assert not list(tmp_path.iterdir())


def test_real_time_takes_two_processes(tmp_path):
    assert "two processes" in refused("run", "ideal", "--realtime", "--in-process")
    assert not list(tmp_path.iterdir())
