"""The recorded drives: today's firmware answers as it did when they were recorded."""

import pytest

from can_rig.scenario.fault_settings import CHANNELS
from firmware_model.firmware import PYTHON_LAW
from tests.rig.replay.recorded import (
    DRIVES,
    FOLDER,
    WithRecordedConstants,
    are_close,
    designed,
    recorded,
    replayed,
    scenario_of,
)

COMMANDS = ("STEER_TORQUE_CMD", "FORCE_DIFF_CMD")


def test_every_drive_is_there_and_says_what_it_is_for():
    for ending in (".log.gz", ".constants.npz"):
        assert {path.name.removesuffix(ending) for path in FOLDER.glob(f"*{ending}")} == set(DRIVES)
    assert all(drive["what_for"] for drive in DRIVES.values())
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 1_000_000


@pytest.mark.parametrize("name", DRIVES)
def test_the_firmware_answers_as_it_did(name):
    scenario = scenario_of(name)
    loop = replayed(name, scenario, WithRecordedConstants(name))
    fault, comparison = scenario.loss, loop.comparison
    lost = round(fault.for_s / scenario.tick_s) if fault.kind.startswith("frames-") else 0
    assert comparison.identical
    assert comparison.ticks == scenario.ticks
    assert comparison.compared == scenario.ticks - lost
    # In every byte, alive counters and checksums included.
    assert comparison.same_bytes == 3 * scenario.ticks - lost
    what = "missing" if fault.kind == "frames-missing" else "wrong CRC"
    expected = {(COMMANDS[CHANNELS.index(fault.channel)], what): lost} if lost else {}
    assert dict(loop.account.counts) == expected


@pytest.mark.parametrize("name", DRIVES)
def test_the_design_gives_the_constants_that_it_gave(name):
    assert are_close(designed(scenario_of(name)), recorded(name))


def test_other_constants_are_told_from_those_of_another_host():
    ours, other = recorded("default"), recorded("default")
    other["table"]["tracking"]["filter"]["coefficients"][0] *= 1.0 + 1e-6
    assert are_close(ours, recorded("default"))
    assert not are_close(ours, other)
    assert not are_close(ours, recorded("changing-speed"))


@pytest.mark.parametrize("name", ["default", "noisy", "slow-bus", "lane-change"])
def test_another_firmware_answers_otherwise(name):
    loop = replayed(name, scenario_of(name, "design.tau_q_s=0.02"), PYTHON_LAW)
    assert not loop.comparison.identical
