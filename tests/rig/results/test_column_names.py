"""Columns of ``signals.csv`` by the names and units of the plant's own signals."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import can_rig
from can_rig.assessment.resolve import load
from can_rig.drawing.names import column_names
from can_rig.logs.columns import APPLIED, EVIDENCE, ON_THE_BUS, TAKEN, TRUE_OUTPUT
from can_rig.scenario.plant_settings import SignalSettings
from can_rig.scenario.sensor_settings import ECHOES, USUAL
from can_rig.views.signal_table import read_table

COLUMN = [
    "plant.input_1={name='reflux', unit='mol/s'}",
    "plant.input_2={name='boil-up', unit='N m'}",
    "plant.output={name='Purity', unit='%'}",
]
CHAPTER_2 = load("chapter-2").plant
SAID = {
    "reference_mps2": "reference_percent",
    "dstar_mps2": "purity_percent",
    "error_mps2": "error_percent",
    "torque_nm": "reflux_mol_per_s",
    "force_difference_n": "boil_up_nm",
    "fault_estimate_mps2": "fault_estimate_percent",
    "true_dstar_mps2": "true_purity_percent",
    "applied_torque_nm": "applied_reflux_mol_per_s",
    "torque_echo_nm": "reflux_echo_mol_per_s",
    "force_difference_echo_n": "boil_up_echo_nm",
    "applied_force_difference_n": "applied_boil_up_nm",
    "evidence_torque_lost": "evidence_reflux_lost",
    "evidence_torque_offset": "evidence_reflux_offset",
    "evidence_force_lost": "evidence_boil_up_lost",
    "evidence_sensor_wrong": "evidence_sensor_wrong",
    "evidence_sensor_drifting": "evidence_sensor_drifting",
    "evidence_sensor_frozen": "evidence_sensor_frozen",
    "evidence_another_car": "evidence_another_car",
}


def test_the_car_has_its_own() -> None:
    assert all(name == column for column, name in column_names(load("default").plant).items())


def test_a_plant_by_numbers_has_its_names_and_units() -> None:
    assert column_names(load("chapter-2", COLUMN).plant) == SAID


def test_without_names_and_units_they_are_roles() -> None:
    names = column_names(CHAPTER_2)
    assert (names["dstar_mps2"], names["torque_nm"]) == ("output_y", "input_1")
    assert names["error_mps2"] == "error"


@pytest.mark.parametrize("name", ["Δφ", "mode", "verdict", "error", "applied input 2", "°"])
def test_a_name_that_would_not_tell_columns_apart_is_its_role(name: str) -> None:
    given_name = f"plant.input_1.name='{name}'"
    names = column_names(load("chapter-2", [given_name]).plant)
    assert names["torque_nm"] == "input_1"
    assert names["dstar_mps2"] == "output"


WORDS = st.text(min_size=1, max_size=6).filter(lambda word: word.isprintable() and word.strip())


@given(st.tuples(WORDS, WORDS, WORDS), WORDS)
def test_no_two_columns_have_one_name(words: tuple[str, str, str], unit: str) -> None:
    output, input_1, input_2 = (SignalSettings(word, unit) for word in words)
    plant = replace(CHAPTER_2, output=output, input_1=input_1, input_2=input_2)
    names = column_names(plant)
    echoes = {USUAL[echo].column for echo in ECHOES}
    assert set(names) <= {*ON_THE_BUS, TRUE_OUTPUT, *APPLIED, *EVIDENCE, *echoes}
    others = [column for column in TAKEN if column not in names]
    assert len({*names.values(), *others}) == len(names) + len(others)
    assert all(re.fullmatch("[0-9a-z_]+", name) for name in names.values())


def test_what_the_plant_reports_under_such_a_name_keeps_it() -> None:
    names = column_names(load("chapter-2", COLUMN).plant, {"purity_percent"})
    assert names == SAID | {"dstar_mps2": "dstar_mps2"}


def test_file_table_and_log_call_them_alike(tmp_path: Path) -> None:
    scenario = load("chapter-2", [*COLUMN, "duration_s=0.4", "fault.at_s=0.2"])
    folder = can_rig.run(scenario).save(tmp_path / "run")
    loaded = can_rig.load(folder)
    with (folder / "signals.csv").open(newline="") as file:
        header = next(csv.reader(file))
    assert header[1:7] == list(SAID.values())[:6]
    assert list(loaded.signals.columns) == header[1:]
    assert loaded.signals.attrs["units"]["reflux_mol_per_s"] == "mol/s"
    assert loaded.signals.attrs["names"]["true_purity_percent"] == "true Purity"
    table = read_table(folder / "bus.log", loaded.scenario)
    assert set(table.columns) == set(header[1:]) - {
        name for name in header if name == "verdict" or name.startswith("evidence_")
    }
