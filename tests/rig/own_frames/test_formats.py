"""A network in any format that cantools reads: the same run writes the same log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cantools
import pytest
from cantools.database.can import Database

from can_rig.assessment.resolve import load
from can_rig.errors import DbcError, ScenarioError
from can_rig.scenario.build import network_of
from tests.helpers import record
from tests.rig.own_frames.arxml import as_arxml, name_of
from tests.rig.own_frames.scenarios import MOTOROLA, SIGNALS, options

SHORT = ["duration_s=0.12", "fault.at_s=0.05"]
WRITERS: dict[str, tuple[Callable[[Database], str], str]] = {
    "kcd": (lambda database: str(database.as_kcd_string()), "utf-8"),
    "sym": (lambda database: str(database.as_sym_string()), "cp1252"),
    "arxml": (as_arxml, "utf-8"),
}
TICKS = {
    "reference": "VMC_Request", "feedback": "ESP_Motion", "command_1": "EPS_Command",
    "command_2": "DRV_Command", "status": "EPS_Status",
}  # fmt: skip


def arxml_options(path: Path) -> list[str]:
    """In ARXML a name is there once, so each message counts the ticks by another."""
    pairs = {role: name.split(".") for role, name in SIGNALS.items()}
    names = {role: f"{m}.{name_of(m, signal)}" for role, (m, signal) in pairs.items()}
    ticks = [f"network.ticks.{role}={name_of(m, 'Count')}" for role, m in TICKS.items()]
    return [*options(path, names, tick=""), *ticks]


@pytest.fixture(scope="module")
def dbc_log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    words = [*SHORT, *options(MOTOROLA, SIGNALS)]
    return record(tmp_path_factory.mktemp("dbc"), *words, name="default")[0].read_bytes()


@pytest.mark.parametrize("kind", WRITERS)
def test_the_log_is_that_of_the_dbc(kind: str, dbc_log: bytes, tmp_path: Path) -> None:
    write, encoding = WRITERS[kind]
    path = tmp_path / f"own.{kind}"
    path.write_text(write(cantools.database.load_file(MOTOROLA)), encoding=encoding)
    words = arxml_options(path) if kind == "arxml" else options(path, SIGNALS)
    (tmp_path / "logs").mkdir()
    log, summary, scenario = record(tmp_path / "logs", *SHORT, *words, name="default")
    assert summary.ticks == scenario.ticks == 120
    assert log.read_bytes() == dbc_log


TICK_KEYS = {
    "network.ticks.feedback=": "network.ticks.feedback: must be set beside the other ticks",
    "network.tick=Count": "network.ticks: must not be set beside network.tick",
    "network.ticks.status=Count_of_EPS_Statis": "network.ticks.status = 'Count_of_EPS_Statis': ",
    "network.ticks.mode=Count": "network.ticks.mode: unknown key",
    "network.ticks.status=Estimate_of_EPS_Status": "and network.ticks.status are both",
}


@pytest.mark.parametrize(("setting", "line"), TICK_KEYS.items(), ids=TICK_KEYS)
def test_a_bad_tick_is_one_line(setting: str, line: str, tmp_path: Path) -> None:
    path = tmp_path / "own.arxml"
    path.write_text(as_arxml(cantools.database.load_file(MOTOROLA)))
    with pytest.raises((ScenarioError, DbcError)) as caught:
        network_of(load("default", [*arxml_options(path), setting]))
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_ticks_need_the_signals() -> None:
    with pytest.raises(ScenarioError, match=r"network\.signals: must be set beside network\.tick"):
        load("default", [f"network.dbc={MOTOROLA}", *(f"network.ticks.{key}=C" for key in TICKS)])
