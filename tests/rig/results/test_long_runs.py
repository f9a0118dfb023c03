"""A long run: the folder of a short run, in memory that hardly grows."""

import gzip
import json
import tracemalloc
from pathlib import Path

import can
import numpy as np
import pytest

from can_rig.nodes.bus_access import StopRequest
from can_rig.plant import in_windows
from can_rig.results.counterfactual import fault_free
from can_rig.results.execution import Execution, Options, execute
from can_rig.scenario.loading import load
from can_rig.storage import paged
from can_rig.views.recorded_run import RecordedRun
from tests.helpers import asked, refused, succeeded
from tests.rig.results.quiet import quiet

TEXTS = ["bus.log", "bus.plant.csv", "signals.csv"]
CASES = {
    "noise": ["plant.sensor.corner_hz=80", "design.alpha=3", "design.alpha_q=4", "fault.at_s=0.2",
              "fault.for_s=0.3"],
    "frames": ["fault.kind=frames-missing", "fault.at_s=0.2", "design.feedback=false"],
    "drive": ["drive.ramps=[[0.0, 27.0], [0.7, 27.5]]", "design.speeds_mps=[27, 28]"],
    "class": ["plant.kind=tests.rig.plant.linear:LinearPlant", "fault.at_s=0.2"],
}  # fmt: skip


def long_from(ticks: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run of more ticks is a long one."""
    monkeypatch.setattr(paged, "PAGED_ROWS", ticks)
    monkeypatch.setattr(paged, "BLOCK_ROWS", ticks // 3)
    monkeypatch.setattr(in_windows, "BLOCK_TICKS", 97)
    monkeypatch.setattr(in_windows, "WINDOW_TICKS", 194)


def run(folder: Path, *settings: str, bus: str | None = None, report: bool = False) -> Execution:
    scenario = load("default", ["duration_s=0.7", *settings])
    done = execute(scenario, folder, StopRequest(), Options(bus=bus, report=report))
    assert done is not None
    return done


def assert_same(short: Path, long: Path) -> None:
    for name in TEXTS:
        packed = (long / f"{name}.gz").read_bytes()
        assert gzip.decompress(packed) == (short / name).read_bytes(), name
        assert packed[3:8] == bytes(5)  # no name and no date
        assert not (long / name).exists()
    said, told = (json.loads((folder / "run.json").read_text()) for folder in (short, long))
    for key in ("scenario", "metrics", "faults", "whose_fault", "ticks", "rejected_frames"):
        assert said[key] == told[key], key


@pytest.mark.parametrize(
    ("case", "bus"), [("frames", None), ("drive", None), ("class", None), ("noise", "virtual:long")]
)
def test_a_long_run_says_what_a_short_one_says(case, bus, tmp_path, monkeypatch):
    run(tmp_path / "short", *CASES[case], bus=bus)
    long_from(100, monkeypatch)
    run(tmp_path / "long", *CASES[case], bus=bus)
    assert_same(tmp_path / "short", tmp_path / "long")


def test_its_reports_are_those_of_a_short_run(folders):
    assert_same(folders / "short", folders / "long")
    for name in ("report.png", "report.html"):
        assert (folders / "short" / name).read_bytes() == (folders / "long" / name).read_bytes()


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """The same run as a short one and as a long one."""
    folder = tmp_path_factory.mktemp("runs")
    run(folder / "short", *CASES["noise"], report=True)
    with pytest.MonkeyPatch.context() as changed:
        long_from(100, changed)
        run(folder / "long", *CASES["noise"], report=True)
    return folder


def test_whoever_reads_a_run_folder_reads_that_of_a_long_run(folders, monkeypatch):
    long_from(100, monkeypatch)
    short, long = folders / "short", folders / "long"
    for form in (long, long / "signals.csv.gz"):
        assert json.loads(asked("diff", short, form, "--json").stdout)["rows"] == 700
    assert asked("diff", long, short / "bus.log", "--scenario", "default").returncode == 0
    assert asked("replay", long).returncode == 0
    assert asked("plot", long, "DStar", "--out", "a.png").returncode == 0
    for words in (["stats"], ["decode"]):
        said = [asked(*words, each).stdout for each in (short, long)]
        assert said[0] == said[1].replace("bus.log.gz", "bus.log")
    assert asked("convert", long, "a.log").returncode == 0
    assert Path("a.log").read_text().count("\n") == 3500
    loaded = [RecordedRun.load(each).signals for each in (short, long)]
    np.testing.assert_array_equal(loaded[0], loaded[1])
    assert sum(1 for _ in can.LogReader(long / "bus.log.gz")) == 3500


def test_a_what_if_of_a_long_run_is_that_of_a_short_one(folders, monkeypatch):
    for name in ("short", "long"):
        succeeded("replay", folders / name, "--what-if", "--set", "plant.mass_kg=1600",
                     "--out", name)  # fmt: skip
        long_from(100, monkeypatch)
    unpacked = gzip.decompress(Path("long/bus.log.gz").read_bytes())
    assert unpacked == Path("short/bus.log").read_bytes()
    assert Path("long/reference.csv").read_bytes() == Path("short/reference.csv").read_bytes()


def test_beside_a_long_run_that_was_stopped_no_run_goes_on_to_the_planned_end(monkeypatch):
    short, planned = (load("default", [f"duration_s={of}", "fault.at_s=0.2"]) for of in (0.7, 3600))
    signals, ends = quiet(short), []
    wanted = fault_free(short, signals)
    long_from(100, monkeypatch)
    run_some = in_windows.LoopInWindows.run

    def run(loop):
        ticks = run_some(loop)
        ends.append(ticks.stop)
        return ticks

    monkeypatch.setattr(in_windows.LoopInWindows, "run", run)
    for found, values in zip(fault_free(planned, signals), wanted, strict=True):
        np.testing.assert_array_equal(found, values)
    assert 700 <= max(ends) < 700 + in_windows.BLOCK_TICKS


def test_a_long_run_is_replaced_as_any_other(folders, tmp_path):
    made = RecordedRun.load(folders / "long").save(tmp_path / "again")
    scenario = load("default", ["duration_s=0.01"])
    assert execute(scenario, made, StopRequest(), Options(force=True)) is not None
    assert sorted(path.name for path in made.iterdir() if path.suffix == ".gz") == []


@pytest.mark.parametrize("damage", [b"", b"\x1f\x8b\x08", b"no gzip"])
def test_a_damaged_table_is_refused_in_a_line(damage, folders, tmp_path):
    path = tmp_path / "signals.csv.gz"
    path.write_bytes(damage)
    assert str(path) in refused("diff", folders / "short", path)


@pytest.mark.parametrize(
    ("bus", "few", "many", "bytes_a_tick"),
    [(None, 2000, 5000, 130), ("virtual:memory", 600, 1800, 330)],
)
def test_memory_hardly_grows_with_a_run(
    bus, few, many, bytes_a_tick, tmp_path,
    monkeypatch,
):  # fmt: skip
    """Reports, of the run without a bus, need more memory than so few ticks: they hide a part."""
    long_from(few // 4 * 3, monkeypatch)
    monkeypatch.setattr(in_windows, "WINDOW_TICKS", 970)
    monkeypatch.setattr("can_rig.drawing.thinning.MAX_POINTS", 1000)
    monkeypatch.setattr("can_rig.drawing.bench.MOST_POINTS", 1000)
    monkeypatch.setattr("can_rig.logs.reading.read_log.__defaults__", (1000, *_rest()))
    peaks = []
    for ticks in (few, few, many):  # the first one compiles, imports and remembers
        if peaks:
            tracemalloc.start()
        settings = f"duration_s={ticks / 1000}", "fault.at_s=0.5"
        run(tmp_path / str(len(peaks)), *settings, bus=bus, report=bus is None)
        peaks.append(tracemalloc.get_traced_memory()[1])  # 0 of the first
        tracemalloc.stop()
    assert (peaks[2] - peaks[1]) / (many - few) < bytes_a_tick


def _rest() -> tuple[object, ...]:
    from can_rig.logs.reading import read_log

    defaults = read_log.__defaults__
    assert defaults is not None
    return defaults[1:]
