"""A film has its pictures, its time, its colours; what cannot be filmed is refused in a line."""

import numpy as np
import pytest
from PIL import Image, ImageSequence

from can_rig.errors import LogError
from can_rig.results.motion import scene
from can_rig.results.source import read_run
from can_rig.views.film import (
    HEIGHT,
    WIDTH,
    Drawing,
    palette,
    pictures,
    refuse_film,
    span_of,
    write_film,
)
from tests.helpers import asked, refused
from tests.rig.results.test_motion import recorded


def ink(picture: Image.Image, colour: str) -> int:
    """How many pixels have a colour of the palette."""
    wanted = [int(palette()[colour][at : at + 2], 16) for at in (1, 3, 5)]
    return int((np.abs(np.asarray(picture).astype(int) - wanted) < 4).all(axis=2).sum())


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """The scene of a run in which the motor dies at 1 s."""
    settings = ["duration_s=4", "fault.at_s=1"]
    scenario, signals = recorded(tmp_path_factory.mktemp("run"), "default", *settings)
    return scene(scenario, signals)


def test_the_failed_part_and_its_name_are_red_from_the_fault_on(drawn):
    drawing = Drawing(drawn)
    assert ink(drawing.at(0.9), "warn") == 0
    assert ink(drawing.at(1.1), "warn") > 50


def test_only_the_car_without_compensation_leaves_the_lane(drawn):
    """The outline of that car is orange; below the lane there is paper otherwise."""
    below = HEIGHT // 2 + 50  # the lane has 3.5 m, or 58 pixels
    for time_s, leaves in ((0.9, False), (4.0, True)):
        picture = Drawing(drawn).at(time_s).crop((0, below, WIDTH // 2, HEIGHT))
        assert (ink(picture, "orange") > 5) == leaves
        assert ink(picture, "blue") == 0


def test_a_car_beyond_the_picture_is_an_arrow_at_the_edge(tmp_path):
    settings = ["fault.at_s=1", "duration_s=6"]
    drawing = Drawing(scene(*recorded(tmp_path, "no-compensation", *settings)))
    assert ink(drawing.at(0.9), "pale-blue") > 50  # the windscreen of a car in sight
    gone = drawing.at(5.9).crop((0, 120, WIDTH, HEIGHT))
    assert ink(gone, "pale-blue") == 0
    assert 20 < ink(gone, "blue") < 200


def test_blocks_show_the_lost_input(tmp_path):
    settings = ["fault.at_s=1", "duration_s=2"]
    drawing = Drawing(scene(*recorded(tmp_path, "nonminimum-phase", *settings)))
    right = (200, 0, WIDTH, HEIGHT)
    before, after = (drawing.at(time_s).crop(right) for time_s in (0.9, 1.1))
    assert ink(before, "warn") == 0
    assert ink(after, "warn") > 100
    assert ink(after, "green") < 0.7 * ink(before, "green")


def test_the_rear_wheels_push_apart_after_the_fault(drawn):
    drawing = Drawing(drawn)
    assert ink(drawing.at(2.0), "green") > ink(drawing.at(0.9), "green") + 40


def test_a_gif_has_a_picture_for_each_time(drawn, tmp_path):
    path = tmp_path / "x.gif"
    write_film(path, ".gif", pictures(drawn, 0.5, 2.5, 10.0, 2.0), 10.0)
    with Image.open(path) as film:
        assert len([*ImageSequence.Iterator(film)]) == 11
        assert film.size == (WIDTH, HEIGHT)
        assert film.info["duration"] == 100


def test_an_mp4_gets_every_picture_and_says_why_ffmpeg_fails(drawn, tmp_path, monkeypatch):
    tool = tmp_path / "bin/ffmpeg"
    tool.parent.mkdir()
    tool.write_text('#!/bin/sh\nfor last; do :; done\ncat >"$last" || exit 1\n')
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", str(tool.parent), prepend=":")
    refuse_film(tmp_path / "x.mp4")
    write_film(tmp_path / "x.mp4", ".mp4", pictures(drawn, 0.5, 0.7, 10.0, 1.0), 10.0)
    assert (tmp_path / "x.mp4").stat().st_size == 3 * WIDTH * HEIGHT * 3
    tool.write_text("#!/bin/sh\necho no codec >&2\nexit 1\n")
    with pytest.raises(LogError, match="ffmpeg: no codec"):
        write_film(tmp_path / "y.mp4", ".mp4", pictures(drawn, 0.5, 0.7, 10.0, 1.0), 10.0)


def test_what_cannot_be_a_film_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(LogError, match="needs ffmpeg, which is not installed"):
        refuse_film(tmp_path / "x.mp4")
    with pytest.raises(LogError, match=r"must be FILE\.gif or FILE\.mp4"):
        refuse_film(tmp_path / "x.avi")


@pytest.mark.parametrize(
    ("begins", "span"), [([1.0], (0.0, 7.0)), ([], (0.0, 9.0)), ([5.0, 4.0], (2.0, 9.0))]
)
def test_a_film_shows_the_time_around_the_first_fault(begins, span):
    dead = [{"begin": begin} for begin in begins]
    assert span_of({"columns": {"time": np.linspace(0.0, 9.0, 10)}, "dead": dead}) == span


@pytest.mark.parametrize("name", ["pendulum", "two-masses"])
def test_another_plant_moves(name, tmp_path):
    scenario, signals = recorded(tmp_path, name, "duration_s=2", "fault.kind=none")
    drawing = Drawing(scene(scenario, signals))
    begin, end = (
        np.asarray(drawing.at(time_s).crop((200, 0, WIDTH, HEIGHT))) for time_s in (0, 1.9)
    )
    assert (begin != end).any(axis=2).sum() > 500


def test_the_command_writes_a_film_of_a_run_folder(tmp_path):
    settings = "--set", "duration_s=0.3", "--set", "fault.at_s=0.1"
    assert asked("run", "ideal", *settings, "--in-process", "--out", "run").returncode == 0
    done = asked("film", "run", "--out", "x.gif", "--to", 0.2)
    assert (done.returncode, done.stdout) == (0, "film in x.gif\n")
    with Image.open("x.gif") as film:
        assert len([*ImageSequence.Iterator(film)]) == 3
    late = asked("film", "run", "--out", "y.gif", "--from", 5, "--to", 6)
    assert late.stderr == "error: --from 5: must be below 0.28 s, the end of the run\n"
    assert asked("run", "ideal", "--set", "duration_s=0.001", "--in-process", "--out", "one")
    short = asked("film", "one", "--out", "y.gif")
    assert short.stderr.startswith("error: one: too short: a film needs a run of two ticks")
    assert "exists; choose" in refused("film", "run", "--out", "x.gif")


def test_a_log_is_no_run_folder(tmp_path):
    log = tmp_path / "bus.log"
    log.write_text("")
    with pytest.raises(LogError, match=r"bus\.log: is a file; must be a run folder$"):
        read_run(log)
