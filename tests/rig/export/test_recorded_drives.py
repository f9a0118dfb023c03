"""The recorded drives through the law in C: every byte that was recorded."""

from __future__ import annotations

import pytest

from can_rig.export.controllers import CompiledLaw
from tests.rig.replay.recorded import DRIVES, WithRecordedConstants, replayed, scenario_of


@pytest.mark.parametrize("name", DRIVES)
def test_c_answers_as_it_was_recorded(name: str) -> None:
    scenario = scenario_of(name)
    law = CompiledLaw(scenario.design.precision, changes_speed=scenario.drive.is_given)
    loop = replayed(name, scenario, WithRecordedConstants(name, law))
    fault, comparison = scenario.loss, loop.comparison
    lost = round(fault.for_s / scenario.tick_s) if fault.kind.startswith("frames-") else 0
    assert comparison.identical
    assert comparison.same_bytes == 3 * scenario.ticks - lost
