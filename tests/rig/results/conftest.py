"""What the tests of results share: a run of both nodes in this process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from can_rig.assessment.resolve import load
from can_rig.controllers.our_law import PYTHON
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.runner import run_in_process
from can_rig.results.signals import Signals, read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario

Run = Callable[..., tuple[Scenario, Signals]]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    runs: list[Path] = []

    def rig(name: str, *settings: str) -> tuple[Scenario, Signals]:
        scenario, log = load(name, settings), tmp_path / f"{len(runs)}.log"
        runs.append(log)
        run_in_process(scenario, "virtual:metrics", log, StopRequest(), lambda tick: None, PYTHON)
        return scenario, read_signals(log, network_of(scenario), scenario.tick_s)

    return rig
