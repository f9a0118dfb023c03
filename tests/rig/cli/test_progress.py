"""The progress bar of a terminal: the bar ends at 100 %, and a pipe gets no bar."""

import os
import re
import subprocess
import sys
import time

import pytest
from rich.progress import Progress

from can_rig.cli import output
from can_rig.cli.main import main
from can_rig.cli.output import car_bar, counting, reading
from can_rig.logs.reading import read_log

TERMINAL = os.environ | {"TTY_COMPATIBLE": "1", "COLUMNS": "120"}


def last_count(text: str) -> str:
    """What the bar, which is drawn again and again, says at last."""
    return re.findall(r"[\d,/]+ (?:ticks|frames|cars)", text)[-1]


def test_the_bar_of_a_complete_run_ends_at_its_last_tick(tmp_path):
    words = ["run", "thesis-step", "--set", "duration_s=1", "--out", str(tmp_path / "r")]
    done = subprocess.run(
        [sys.executable, "-m", "can_rig", *words],
        env=TERMINAL, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert last_count(done.stderr) == "1,000/1,000 ticks"


def test_a_name_in_brackets_is_a_name(capsys, monkeypatch):
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    with counting("car [b]", "ticks", 10) as on_tick:
        on_tick(10)
    assert "car [b]" in capsys.readouterr().err


def test_where_standard_error_is_no_terminal_there_is_no_bar(capsys):
    with counting("x", "ticks", 10) as on_tick:
        on_tick(10)
    assert capsys.readouterr().err == ""


def test_the_bar_of_a_log_ends_at_its_last_frame(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "120")
    log = tmp_path / "a.log"
    log.write_text("".join(f"({i}.000000) can0 101#00\n" for i in range(2500)))
    frames = sum(len(chunk) for chunk in reading(read_log(log, 100), "reading"))
    assert frames == 2500
    assert last_count(capsys.readouterr().err) == "2,500 frames"


def test_it_is_drawn_by_no_thread_and_seldom(monkeypatch):
    """A process with a bar forks its nodes, and a node reports every tick."""
    import threading

    now_s = 0.0
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    drawn = 0

    def refresh(_: object) -> None:
        nonlocal drawn
        drawn += 1

    before = threading.active_count()
    with counting("x", "ticks", 1000) as on_tick:
        monkeypatch.setattr(Progress, "refresh", refresh)
        for tick in range(1, 1001):
            now_s = tick * 1e-3
            on_tick(tick)
        assert threading.active_count() == before
        assert 8 <= drawn <= 11


@pytest.mark.parametrize(("car_s", "drawn"), [(0.05, False), (0.5, True)])
def test_drives_of_many_cars_have_a_bar_where_they_take_long(car_s, drawn, monkeypatch, capsys):
    """Most take a moment: a bar would only flash."""
    now_s = 0.0
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    with car_bar() as on_car:
        for car in range(1, 18):
            now_s = car * car_s
            on_car(car, 17)
            if car == 1:
                assert capsys.readouterr().err == ""
    shown = capsys.readouterr().err
    assert (last_count(shown) == "17/17 cars") if drawn else (shown == "")


def test_check_shows_the_bar_over_the_cars_that_it_drives(monkeypatch, capsys):
    """16 vertices of the box and 8 cars from its inside."""
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(output, "LONG_S", 0.0)
    with pytest.raises(SystemExit) as end:
        main(["check", "ideal", "--set", "tick_s=0.01", "--set", "design.tau_q_s=0.03"])
    assert end.value.code in {0, 1}
    shown = re.findall(r"[\d,/]+ cars", capsys.readouterr().err)
    assert shown[-1] == "24/24 cars"
