"""``report.png``: its content, and a picture without a warning of every run, however short."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from can_rig.drawing.style import SHADE
from can_rig.nodes.realtime.timing import Timing
from can_rig.results.metrics import metrics, rows
from can_rig.results.report import page as report
from can_rig.results.run_folder import Outcome, finish
from can_rig.results.signals import Signals, read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario
from tests.helpers import record

pytestmark = pytest.mark.filterwarnings("error")
SHORT = ["duration_s=0.2", "fault.at_s=0.1"]


def recorded(folder: Path, *settings: str, name: str = "default") -> tuple[Scenario, Signals]:
    log, _, scenario = record(folder, *SHORT, *settings, name=name)
    return scenario, read_signals(log, network_of(scenario), scenario.tick_s)


def drawn(folder: Path, name: str, *settings: str) -> Figure:
    scenario, signals = recorded(folder, *settings, name=name)
    return report.page(scenario, network_of(scenario), signals)


def test_title_and_units_say_what_was_run(tmp_path):
    page = drawn(tmp_path, "thesis-step", "plant.variant=published", "fault.for_s=0.05")
    title = page.get_suptitle()
    for words in (
        "thesis-step: steering torque lost from 0.1 s to 0.15 s (actuator dead)",
        "published model",
    ):
        assert words in title
    assert "tick 1 ms, latency 0 ticks" in title
    labels = [axis.get_ylabel() for axis in page.axes]
    assert labels[0] == "D*\nin m/s²"
    assert labels[1] == "error, rms\nin m/s²"
    assert labels[2:4] == ["steering torque\nin N m", "rear force difference\nin N"]


@pytest.mark.parametrize("amplitude", [-1e-4, -1e-3, -20.0])
def test_no_label_leaves_the_page(tmp_path, amplitude):
    """The margins are fixed, and the numbers beside an axis are as long as they are."""
    units = [f"plant.{signal}.unit=%" for signal in ("input_1", "input_2", "output")]
    page = drawn(tmp_path, "chapter-2", f"reference.amplitude_mps2={amplitude}", *units)
    page.draw_without_rendering()
    for axis in page.axes:
        assert axis.yaxis.label.get_window_extent().x0 > 0.0
        assert axis.yaxis.get_tightbbox().x0 > 0.0


def test_times_of_the_two_columns_do_not_overlap(tmp_path):
    page = drawn(tmp_path, "default", "duration_s=0.5", "fault.at_s=0")
    page.draw_without_rendering()
    below = sorted(
        (axis for axis in page.axes if axis.get_xlabel()), key=lambda a: a.get_position().x0
    )
    ends = [
        [text.get_window_extent() for text in axis.get_xticklabels() if text.get_text()]
        for axis in below
    ]
    left, right = (
        [box for box, at in zip(boxes, axis.get_xticks(), strict=True)
         if axis.get_xlim()[0] <= at <= axis.get_xlim()[1]]
        for boxes, axis in zip(ends, below, strict=True)
    )  # fmt: skip
    assert max(box.x1 for box in left) < min(box.x0 for box in right)


def test_loss_and_gust_are_shaded_where_they_were(tmp_path):
    gust = "disturbance={kind='gust', at_s=0.12, for_s=0.06, force_n=1}"
    page = drawn(tmp_path, "thesis-step", "fault.for_s=0.05", gust)
    for axis in page.axes:
        (span,) = (p for p in axis.patches if p.get_facecolor()[:3] == to_rgb(SHADE))
        assert span.get_extents().transformed(axis.transData.inverted()).intervalx == pytest.approx(
            [0.1, 0.15]
        )
        (wind,) = (p for p in axis.patches if p is not span)
        assert wind.get_extents().transformed(axis.transData.inverted()).intervalx == pytest.approx(
            [0.12, 0.18]
        )


def test_the_speed_of_a_car_that_stands_has_a_scale(tmp_path):
    scenario, signals = recorded(tmp_path, "drive.speed_mps=0")
    signals.plant["speed_mps"] = np.zeros_like(signals.time_s)
    page = report.page(scenario, network_of(scenario), signals)
    (speed,) = (a for a in page.axes if any("speed" in text.get_text() for text in a.texts))
    assert speed.get_ylim() == (0.0, 1.0)


@pytest.mark.parametrize("setting", ["fault.kind=none", "fault.at_s=0.5"])
def test_nothing_is_shaded_where_nothing_was_lost(tmp_path, setting):
    page = drawn(tmp_path, "thesis-step", setting)
    assert not any(axis.patches for axis in page.axes)


def test_a_spike_is_off_the_scale_and_said_to_be(tmp_path):
    page = drawn(tmp_path, "thesis-step", "duration_s=3.0", "fault.at_s=1.5")
    torque, force = page.axes[2:4]
    assert torque.get_ylim()[1] < 1000.0
    assert torque.texts[0].get_text() == "peak 249000 N m at 0 s"
    page.canvas.draw()
    for axis in (torque, force):
        boxes = [part.get_window_extent() for part in (axis.texts[0], axis.get_legend())]
        assert not boxes[0].overlaps(boxes[1])


def limit_drawn(force: Axes) -> list[float]:
    return [float(line.get_ydata()[0]) for line in force.lines if "limit" in line.get_label()]


def test_the_limit_of_the_force_is_drawn_in_view_where_the_force_comes_near(tmp_path):
    lost = ("duration_s=0.5", "fault.at_s=0.2", "reference.amplitude_mps2=-1.0")
    force = drawn(tmp_path, "thesis-step", *lost).axes[3]
    (limit,) = limit_drawn(force)
    assert force.get_ylim()[0] < limit < 0.0
    spike = drawn(tmp_path, "thesis-step", "duration_s=1.0", "fault.kind=none").axes[3]
    assert spike.texts
    assert not limit_drawn(spike)


def test_an_open_loop_shows_its_deviation_and_not_an_error(tmp_path):
    output, deviation, *_ = drawn(tmp_path, "chapter-2").axes
    assert deviation.get_ylabel() == "deviation, rms"
    assert [line.get_label() for line in output.lines[:3]] == [
        "output y",
        "without the fault",
        "output y without compensation",
    ]
    time_s, size = deviation.lines[0].get_data()
    assert np.max(np.asarray(size)[np.asarray(time_s) < 0.1]) < 5e-8
    assert np.max(size) > 1e-4


def test_the_curves_differ_in_grey(tmp_path):
    output = drawn(tmp_path, "thesis-sine").axes[0]
    styles = [line.get_linestyle() for line in output.lines[:2]]
    assert styles[0] != styles[1]


def test_a_run_of_one_tick_is_drawn_as_points(tmp_path):
    page = drawn(tmp_path, "thesis-step", "duration_s=0.001")
    assert {axis.lines[0].get_marker() for axis in page.axes} == {"o"}
    longer = drawn(tmp_path, "thesis-step", "duration_s=0.002")
    assert {axis.lines[0].get_marker() for axis in longer.axes} == {"None"}


@pytest.mark.parametrize(
    ("name", "frames"),
    [*(("thesis-step", frames) for frames in (0, 1, 503)), ("chapter-2", 503),
     ("no-compensation", 499)],
)  # fmt: skip
def test_every_run_that_ends_early_is_reported(tmp_path, name, frames):
    log, _, scenario = record(tmp_path, *SHORT, "plant.sensor.noise_mps2=0.005", name=name)
    lines = log.read_text().splitlines(keepends=True)
    (tmp_path / "bus.log").write_text("".join(lines[:frames]) + lines[frames][:25])
    finish(tmp_path, scenario, network_of(scenario), Outcome("local"))
    assert (tmp_path / "report.png").read_bytes().startswith(b"\x89PNG")
    assert len((tmp_path / "signals.csv").read_text().splitlines()) == 1 + -(-frames // 5)
    metrics = json.loads((tmp_path / "run.json").read_text())["metrics"]
    assert (metrics["deviation_peak_after_fault_mps2"] is not None) == (frames > 501)


@pytest.mark.parametrize(
    ("kind", "channel"), [("frames-missing", "torque"), ("frames-corrupted", "force-difference")]
)
def test_lost_frames_are_gaps_in_the_command(tmp_path, kind, channel):
    page = drawn(
        tmp_path,
        "thesis-sine",
        f"fault.kind={kind}",
        f"fault.channel={channel}",
        "fault.for_s=0.02",
    )
    shown = np.asarray(page.axes[2 + (channel != "torque")].lines[0].get_ydata(), dtype=float)
    assert np.flatnonzero(np.isnan(shown)).tolist() == list(range(100, 120))


def test_a_real_time_run_shows_how_late_it_was(tmp_path):
    """Three wake-ups of 15 µs, one of 3 ms: the bars of the two bins that they fall in."""
    timing = Timing(1_000_000)
    for tick, late_ns in enumerate([15_000, 15_000, 15_000, 3_000_000], start=1):
        timing.woke(tick, late_ns)
    scenario, signals = recorded(tmp_path)
    page = report.page(scenario, network_of(scenario), signals, timing.as_dict())
    assert len(page.axes) == len(report.page(scenario, network_of(scenario), signals).axes) + 1
    (axis,) = (axis for axis in page.axes if "µs" in axis.get_xlabel())
    wake_ups = next(c for c in axis.containers if c.get_label() == "wake-up lateness")
    labels = [label.get_text() for label in axis.get_xticklabels()]
    heights = {labels[at]: bar.get_height() for at, bar in enumerate(wake_ups) if bar.get_height()}
    assert heights == {"10": 3, "2000": 1}
    assert page.canvas.get_width_height()


def test_what_the_dead_motor_applies_is_shown_beside_its_command(tmp_path):
    page = drawn(tmp_path, "partial-loss", "fault.left=0.25")
    commanded, applied = (np.asarray(line.get_ydata()) for line in page.axes[2].lines[:2])
    assert [line.get_label() for line in page.axes[2].lines[:2]] == ["commanded", "applied"]
    np.testing.assert_array_equal(applied[1:100], commanded[:99])
    np.testing.assert_array_equal(applied[100:], 0.25 * commanded[99:-1])
    assert "applied" not in [line.get_label() for line in page.axes[3].lines]


def test_a_thin_line_is_the_run_without_compensation(tmp_path):
    """From the fault on, and as a run through the bus has it."""
    kind = ("fault.kind=frames-missing", "plant.sensor.noise_mps2=0.001")
    output = drawn(tmp_path, "default", *kind).axes[0]
    thin = next(line for line in output.lines if line.get_label() == "D* without compensation")
    off, expected = recorded(tmp_path, *kind, "design.compensation=off")
    np.testing.assert_allclose(np.asarray(thin.get_xdata()), expected.time_s[100:])
    np.testing.assert_allclose(np.asarray(thin.get_ydata()), expected.dstar_mps2[100:], atol=1e-6)
    assert thin.get_linewidth() < 0.5 * output.lines[0].get_linewidth()
    page = report.page(off, network_of(off), expected)
    assert len(page.axes[0].lines) == 3  # output, reference and the edge of the shade


def test_a_biased_sensor_is_shown_beside_the_car(tmp_path):
    page = drawn(tmp_path, "default", "fault.kind=sensor-biased", "fault.bias_mps2=0.25")
    measured, _, car = (np.asarray(line.get_ydata()) for line in page.axes[0].lines[:3])
    np.testing.assert_allclose(measured[100:] - car, 0.25)
    assert page.axes[0].get_ylabel() == "D* as measured\nin m/s²"
    assert "D* biased by 0.25 m/s² at 0.1 s" in page.get_suptitle()
    assert "applied" not in [line.get_label() for axis in page.axes for line in axis.lines]


@pytest.mark.parametrize("name", ["default", "chapter-2"])
def test_title_shade_panel_and_closing_table_use_one_name(tmp_path, name):
    scenario, signals = recorded(tmp_path, "fault.channel=force-difference", name=name)
    page = report.page(scenario, network_of(scenario), signals)
    lost = {"default": "rear force difference", "chapter-2": "input 2"}[name]
    assert f"{lost} lost at 0.1 s" in page.get_suptitle()
    assert [text.get_text() for text in page.axes[0].texts] == [f"{lost} lost"]
    assert page.axes[3].get_ylabel().splitlines()[0] == lost
    labels = [label for label, _ in rows(metrics(scenario, signals), scenario.plant)]
    assert f"|{lost}|, peak" in labels


def test_the_title_says_what_of_the_plan_did_not_happen(tmp_path):
    late = drawn(tmp_path, "thesis-step", "fault.at_s=0.5").get_suptitle()
    assert "lost at 0.5 s, after the end of the run" in late
    log, _, scenario = record(tmp_path, *SHORT)
    log.write_text("".join(log.read_text().splitlines(keepends=True)[: 5 * 50]))
    signals = read_signals(log, network_of(scenario), scenario.tick_s)
    short = report.page(scenario, network_of(scenario), signals).get_suptitle()
    assert short.splitlines()[-1] == "ended at 0.05 s of 0.2 s"


def test_the_error_of_a_coarse_sensor_is_a_band_and_no_block(tmp_path):
    """Many a measurement is the reference itself: without a floor seven decades are one block."""
    _, distance, *_ = drawn(tmp_path, "chassis-can-coarse", "duration_s=8").axes
    time_s, size = (np.asarray(each) for each in distance.lines[0].get_data())
    assert size[time_s > 2.0].min() >= 0.1 * 0.05
    assert np.ptp(np.log10(size[time_s > 2.0])) < 1.5
