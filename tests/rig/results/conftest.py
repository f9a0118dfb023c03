"""What the tests of results share: a run of both nodes in this process."""

import pytest

from can_rig.results.signals import Signals, read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario
from tests.helpers import record


@pytest.fixture
def run(tmp_path):
    def rig(name: str, *settings: str) -> tuple[Scenario, Signals]:
        log, _, scenario = record(tmp_path, *settings, name=name)
        return scenario, read_signals(log, network_of(scenario), scenario.tick_s)

    return rig
