"""A log's rows: cantools' own decode, and what is left of a log that is damaged or cut."""

import csv
import math
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cantools
import numpy as np
import pytest
from can import LogReader
from hypothesis import given, strategies as st

import can_rig
from can_rig.drawing.names import column_names
from can_rig.frames.codec import Transmitter
from can_rig.frames.network import Network
from can_rig.logs.columns import (
    APPLIED,
    EVIDENCE,
    ON_THE_BUS,
    ON_THE_BUS as COLUMNS,
    TAKEN,
    TRUE_OUTPUT,
)
from can_rig.results.signals import Signals, read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from can_rig.scenario.plant_settings import SignalSettings
from can_rig.scenario.sensor_settings import USUAL
from can_rig.views.signal_table import read_table
from tests.helpers import on_a_bus

SCENARIO = load(
    "thesis-sine",
    ["duration_s=0.06", "fault.kind=frames-corrupted", "fault.at_s=0.03", "fault.for_s=0.01"],
)
NETWORK = network_of(SCENARIO)
TICK_S = SCENARIO.tick_s
VALUES = (
    "reference_mps2", "dstar_mps2", "torque_nm", "force_difference_n", "fault_estimate_mps2",
    "mode", "fault_state", "verdict",
)  # fmt: skip
LOST = range(30, 40)
HEADER = {"Checksum", "AliveCounter", "Tick", "Mode", "FaultState", "Verdict"}


@pytest.fixture(scope="module")
def lines(tmp_path_factory):
    log = tmp_path_factory.mktemp("run") / "bus.log"
    on_a_bus(SCENARIO, log)
    return log.read_text().splitlines(keepends=True)


def read(tmp_path: Path, lines: Iterable[str], network: Network = NETWORK) -> Signals:
    log = tmp_path / "bus.log"
    log.write_text("".join(lines))
    return read_signals(log, network, TICK_S)


def table(signals: Signals) -> np.ndarray:
    return np.array([getattr(signals, name) for name in VALUES]).T


def test_rows_are_cantools_own_decode(tmp_path, lines):
    signals = read(tmp_path, lines)
    database = cantools.database.load_file(
        Path(__file__).parents[3] / "dbc" / "steer_by_wire.dbc", strict=True
    )
    at = {codec.frame_id: column for column, codec in enumerate(NETWORK)}
    expected = np.full((60, len(VALUES)), np.nan)
    for message in LogReader(tmp_path / "bus.log"):
        tick, column = math.floor(message.timestamp / TICK_S + 0.1), at[message.arbitration_id]
        if column == 2 and tick in LOST:
            continue  # corrupted on the way, and not to be used
        decoded = database.decode_message(message.arbitration_id, message.data, False)
        assert decoded["Tick"] == tick
        (value,) = (v for k, v in decoded.items() if k not in HEADER)
        expected[tick, column] = value
        if column == 4:
            codes = ("Mode", "FaultState", "Verdict")
            expected[tick, 5:] = [decoded[name] for name in codes]
    np.testing.assert_allclose(table(signals), expected, rtol=1e-15, atol=1e-15)
    assert np.isnan(signals.torque_nm).sum() == len(LOST)
    np.testing.assert_array_equal(signals.time_s, np.arange(60) * TICK_S)


@pytest.mark.parametrize("first", range(100, 106))
def test_a_log_that_starts_late_knows_where_it_is(tmp_path, lines, first):
    whole, late = read(tmp_path, lines), read(tmp_path, lines[first:])
    begin = first // 5 + (first % 5 > 1)  # commands and a status alone say nothing of the tick
    assert late.time_s[0] == whole.time_s[begin]
    expected = table(whole)[begin:]
    if first % 5 == 1:
        expected[0, 0] = np.nan  # its reference came before the log
    np.testing.assert_array_equal(table(late), expected)


@pytest.mark.parametrize("last", [*range(6), *range(155, 161)])
@pytest.mark.parametrize("cut", [0, 1, 9, 20, 30])
def test_a_log_that_stops_in_mid_tick(tmp_path, lines, last, cut):
    """``cut`` characters of one more line, as a killed run leaves them."""
    whole = table(read(tmp_path, lines))
    signals = read(tmp_path, [*lines[:last], lines[last][:cut]])
    expected = whole[: math.ceil(last / 5)].copy()
    if last % 5:
        expected[-1, last % 5 : 5] = np.nan
        expected[-1, 5:] = np.nan
    np.testing.assert_array_equal(table(signals), expected)


@pytest.mark.parametrize("column", range(5))
def test_one_damaged_frame_costs_one_cell(tmp_path, lines, column):
    whole = table(read(tmp_path, lines))
    at = 5 * 20 + column
    flipped = f"{int(lines[at][-4], 16) ^ 1:X}"
    damaged = lines[at][:-4] + flipped + lines[at][-3:]
    expected = whole.copy()
    expected[20, column] = np.nan
    if column == 4:
        expected[20, 5:] = np.nan
    signals = read(tmp_path, [*lines[:at], damaged, *lines[at + 1 :]])
    np.testing.assert_array_equal(table(signals), expected)
    without = read(tmp_path, [*lines[:at], *lines[at + 1 :]])
    np.testing.assert_array_equal(table(without), expected)


@pytest.mark.parametrize("ticks", [1, 2, 13, 14, 15, 16, 17])
def test_ticks_that_are_missing_are_rows_of_nan(tmp_path, lines, ticks):
    """A gap longer than the alive counter can measure is still a gap, and costs nothing more."""
    whole = table(read(tmp_path, lines))
    signals = read(tmp_path, [*lines[:50], *lines[5 * (10 + ticks) :]])
    # After 14 the counter is the last one's again, which E2E takes for a repetition.
    lost = ticks + (ticks == 14)
    whole[10 : 10 + lost] = np.nan
    np.testing.assert_array_equal(table(signals), whole)


def test_frames_of_another_tick_and_repeated_ones_change_nothing(tmp_path, lines):
    whole = table(read(tmp_path, lines))
    old, torque = lines[5 * 8 + 2], lines[5 * 20 + 2]
    replayed = [*lines[:102], old, *lines[102:103], torque, lines[5 * 19], *lines[103:]]
    np.testing.assert_array_equal(table(read(tmp_path, replayed)), whole)


def test_other_frames_are_not_ours(tmp_path, lines):
    whole = table(read(tmp_path, lines))
    others = [
        "(0.001000) vcan0 00000100#1401010000E1F505 T\n",  # extended, the same number
        "(0.001000) vcan0 100#R8\n",  # remote
        "(0.001000) vcan0 100##11401010000E1F505\n",  # FD
        "(0.001000) vcan0 7FF#01\n",
        "\n",
    ]
    mixed = [text for line in lines for text in (*others, line)]
    np.testing.assert_array_equal(table(read(tmp_path, mixed)), whole)


@pytest.mark.parametrize(
    ("first", "offset_s", "shown"),
    [
        (2 * 65536 + 65530, 0.0, 2 * 65536 + 65530),
        (3, 0.0, 3),
        (65540, 1.7e9 + 0.3, 4),  # wall-clock stamps: 16 bits are all there is
    ],
)
def test_the_tick_counts_on_over_the_16_bits_of_the_wire(tmp_path, first, offset_s, shown):
    senders = [Transmitter(codec) for codec in NETWORK]
    lines = []
    for tick in range(first, first + 12):
        for place, sender in enumerate(senders):
            data = sender.frame(0.5, tick, 1).data.hex().upper()
            time_s = offset_s + tick * TICK_S + place * 1e-6
            lines.append(f"({time_s:.6f}) can0 {sender.codec.frame_id:03X}#{data}\n")
    signals = read(tmp_path, lines)
    np.testing.assert_allclose(signals.time_s, (shown + np.arange(12)) * TICK_S, rtol=1e-15)
    assert not np.isnan(table(signals)).any()


def test_commands_before_any_tick_is_known_are_not_used(tmp_path):
    """Of all ticks, 65535 is the one that looks like the tick before 0."""
    lines = []
    for codec in (NETWORK.command_1, NETWORK.status):
        data = Transmitter(codec).frame(0.5, 65535, 1).data.hex().upper()
        lines.append(f"(0.000002) vcan0 {codec.frame_id:03X}#{data} R\n")
    assert len(read(tmp_path, lines)) == 0


def test_csv_has_the_contract_s_columns_and_empty_cells(tmp_path, lines):
    signals = read(tmp_path, lines)
    signals.write_csv(tmp_path / "signals.csv", SCENARIO.plant)
    back = np.genfromtxt(tmp_path / "signals.csv", delimiter=",", names=True)
    assert back.dtype.names == (*COLUMNS, *signals.plant)
    for name in COLUMNS:
        np.testing.assert_allclose(back[name], getattr(signals, name), rtol=1e-9, atol=1e-12)
    assert (tmp_path / "signals.csv").read_text().splitlines()[31].split(",")[4] == ""


COLUMN = [
    "plant.input_1={name='reflux', unit='mol/s'}",
    "plant.input_2={name='boil-up', unit='N m'}",
    "plant.output={name='Purity', unit='%'}",
]
CHAPTER_2 = load("chapter-2").plant
SAID = {
    "reference_mps2": "reference_percent", "dstar_mps2": "purity_percent",
    "error_mps2": "error_percent", "torque_nm": "reflux_mol_per_s",
    "force_difference_n": "boil_up_nm", "fault_estimate_mps2": "fault_estimate_percent",
    "true_dstar_mps2": "true_purity_percent", "applied_torque_nm": "applied_reflux_mol_per_s",
    "torque_echo_nm": "reflux_echo_mol_per_s", "force_difference_echo_n": "boil_up_echo_nm",
    "applied_force_difference_n": "applied_boil_up_nm",
    "evidence_torque_lost": "evidence_reflux_lost",
    "evidence_torque_offset": "evidence_reflux_offset",
    "evidence_force_lost": "evidence_boil_up_lost",
    "evidence_sensor_wrong": "evidence_sensor_wrong",
    "evidence_sensor_drifting": "evidence_sensor_drifting",
    "evidence_sensor_frozen": "evidence_sensor_frozen",
    "evidence_another_car": "evidence_another_car",
    "measured_yaw_rate_rad_per_s": "measured_output_2",
    "measured_lateral_acceleration_mps2": "measured_output_3",
    "measured_steering_angle_rad": "measured_output_4",
}  # fmt: skip


def test_the_car_has_its_own():
    assert all(name == column for column, name in column_names(load("default").plant).items())


def test_a_plant_by_numbers_has_its_names_and_units():
    assert column_names(load("chapter-2", COLUMN).plant) == SAID


def test_without_names_and_units_they_are_roles():
    names = column_names(CHAPTER_2)
    assert (names["dstar_mps2"], names["torque_nm"]) == ("output_y", "input_1")
    assert names["error_mps2"] == "error"


@pytest.mark.parametrize("name", ["Δφ", "mode", "verdict", "error", "applied input 2", "°"])
def test_a_name_that_would_not_tell_columns_apart_is_its_role(name):
    given_name = f"plant.input_1.name='{name}'"
    names = column_names(load("chapter-2", [given_name]).plant)
    assert names["torque_nm"] == "input_1"
    assert names["dstar_mps2"] == "output"


WORDS = st.text(min_size=1, max_size=6).filter(
    lambda word: word.isprintable() and word.strip() and "$" not in word
)


@given(st.tuples(WORDS, WORDS, WORDS), WORDS)
def test_no_two_columns_have_one_name(words, unit):
    output, input_1, input_2 = (SignalSettings(word, unit) for word in words)
    plant = replace(CHAPTER_2, output=output, input_1=input_1, input_2=input_2)
    names = column_names(plant)
    sensors = {each.column for each in USUAL.values()}
    assert set(names) <= {*ON_THE_BUS, TRUE_OUTPUT, *APPLIED, *EVIDENCE, *sensors}
    others = [column for column in TAKEN if column not in names]
    assert len({*names.values(), *others}) == len(names) + len(others)
    assert all(re.fullmatch("[0-9a-z_]+", name) for name in names.values())


def test_what_the_plant_reports_under_such_a_name_keeps_it():
    names = column_names(load("chapter-2", COLUMN).plant, {"purity_percent"})
    assert names == SAID | {"dstar_mps2": "dstar_mps2"}


def test_file_table_and_log_call_them_alike(tmp_path):
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
