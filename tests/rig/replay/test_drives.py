"""The recorded drives: today's firmware answers as it did when they were recorded."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from can_rig.assessment.resolve import load
from can_rig.logs.reading import read_log
from can_rig.replay.replay import OpenLoop
from can_rig.scenario.build import network_of
from can_rig.scenario.tables.fault import CHANNELS

FOLDER = Path(__file__).parents[2] / "drives"
DRIVES: dict[str, dict[str, Any]] = tomllib.loads((FOLDER / "drives.toml").read_text("utf-8"))
COMMANDS = ("STEER_TORQUE_CMD", "FORCE_DIFF_CMD")


def replayed(name: str, *settings: str) -> OpenLoop:
    drive = DRIVES[name]
    scenario = load(drive["scenario"], [*drive["set"], *settings])
    loop = OpenLoop(scenario, network_of(scenario), lambda gap: None)
    loop.run(read_log(FOLDER / f"{name}.log.gz"))
    return loop


def test_every_drive_is_there_and_says_what_it_is_for() -> None:
    assert {path.name.removesuffix(".log.gz") for path in FOLDER.glob("*.gz")} == set(DRIVES)
    assert all(drive["what_for"] for drive in DRIVES.values())
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 1_000_000


@pytest.mark.parametrize("name", DRIVES)
def test_the_firmware_answers_as_it_did(name: str) -> None:
    loop = replayed(name)
    scenario = load(DRIVES[name]["scenario"], DRIVES[name]["set"])
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


@pytest.mark.parametrize("name", ["default", "noisy", "slow-bus", "lane-change"])
def test_another_firmware_answers_otherwise(name: str) -> None:
    loop = replayed(name, "design.tau_q_s=0.02")
    assert not loop.comparison.identical
