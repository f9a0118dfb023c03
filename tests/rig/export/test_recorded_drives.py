"""The recorded drives through the law in C: every byte that was recorded."""

from __future__ import annotations

import pytest

from can_rig.assessment.resolve import load
from can_rig.export.running.compiled_law import CompiledLaw
from can_rig.logs.reading import read_log
from can_rig.replay.replay import OpenLoop
from can_rig.scenario.build import network_of
from tests.rig.replay.test_drives import DRIVES, FOLDER


@pytest.mark.parametrize("name", DRIVES)
def test_c_answers_as_it_was_recorded(name: str) -> None:
    scenario = load(DRIVES[name]["scenario"], DRIVES[name]["set"])
    law = CompiledLaw(scenario.design.precision, changes_speed=scenario.drive.is_given)
    loop = OpenLoop(scenario, network_of(scenario), lambda gap: None, law=law)
    loop.run(read_log(FOLDER / f"{name}.log.gz"))
    fault, comparison = scenario.loss, loop.comparison
    lost = round(fault.for_s / scenario.tick_s) if fault.kind.startswith("frames-") else 0
    assert comparison.identical
    assert comparison.same_bytes == 3 * scenario.ticks - lost
