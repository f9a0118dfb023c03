"""A run in real time, replayed: what was not answered, or too late, is so again."""

from __future__ import annotations

from pathlib import Path

import pytest

from can_rig.logs.reading import read_log
from can_rig.replaying.replay import OpenLoop
from can_rig.replaying.rig_frames import Recorded, recorded
from tests.rig.nodes.world import World, hold_up, scenario_of

LATE = range(120, 126)


@pytest.fixture(params=["never answered", "sent too late", "in time"])
def run(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[World, Path, str]:
    """A run on a clock that the test turns."""
    scenario = scenario_of("latency_ticks=1", "reference.kind=step", "duration_s=0.3")
    answers = lambda tick: None if tick in LATE else 200_000  # noqa: E731
    world = World(scenario, answers) if request.param == "never answered" else World(scenario)
    if request.param == "sent too late":
        hold_up(world, dict.fromkeys(LATE, 1_100_000))
    log = tmp_path / "bus.log"
    world.run(log)
    return world, log, request.param


def replayed(world: World, log: Path, answers: Recorded | None) -> OpenLoop:
    loop = OpenLoop(world.scenario, world.network, recorded=answers)
    loop.run(read_log(log))
    return loop


def test_the_replay_of_a_run_in_real_time_is_that_run(run: tuple[World, Path, str]) -> None:
    world, log, what = run
    answers = recorded(read_log(log), world.network, world.scenario)
    loop = replayed(world, log, answers)
    assert loop.comparison.identical
    assert loop.comparison.compared >= 290
    unanswered = {tick for tick in range(300) if answers.answered.get(tick, 0) < 2}
    if what == "never answered":
        assert unanswered >= set(LATE)
    if what in {"never answered", "sent too late"}:
        assert unanswered | answers.late >= set(LATE)
        assert not replayed(world, log, None).comparison.identical
    if what == "in time":
        assert not unanswered | answers.late
        assert replayed(world, log, None).comparison.identical
