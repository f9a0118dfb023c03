"""The user's frames in the exported C: the bits of cantools, the bus log of the node in Python."""

import ctypes
import math
import re
from fractions import Fraction
from pathlib import Path

import cantools
import numpy as np
import pytest
from hypothesis import Phase, given, settings, strategies as st

from can_rig.controllers.ecus import HostEcu, host_library
from can_rig.controllers.making import controller_of
from can_rig.errors import ExportError
from can_rig.export.application import application
from can_rig.export.network_code import SENT, frame_bytes
from can_rig.frames.codec import ROLES
from can_rig.frames.foreign_frames import Roles, map_network
from can_rig.frames.network import Network
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load, load_values
from tests.helpers import succeeded
from tests.rig.export.shared import (
    EMULATED,
    STRICT,
    frames_in_c,
    judged_alike,
    log_from,
    log_of,
    run,
)
from tests.rig.own_frames.scenarios import (
    CALM,
    ESP12,
    FD_SIGNALS,
    MOTOROLA,
    SIGNALS,
    database,
    options,
)

IDS = {role: 7 * n for n, role in enumerate(ROLES, 1)}


@st.composite
def signals(draw: st.DrawFn) -> tuple[str, str]:
    """The line of a value in a DBC, beyond bit 48 of 16 bytes, and its type there."""
    form = draw(st.sampled_from(["", "", "", "1", "2"]))
    bits = {"": draw(st.integers(2, 64)), "1": 32, "2": 64}[form]
    at, motorola, signed = draw(st.integers(0, 80 - bits)), draw(st.booleans()), draw(st.booleans())
    start = 8 * (6 + at // 8) + 7 - at % 8 if motorola else 48 + at
    place = f"{start}|{bits}@{'0' if motorola else '1'}{'-' if signed or form else '+'}"
    if form:
        most = draw(st.sampled_from([0, 0, 2, 1e6]))
        return f"{place} (1,0) [{0 - most:g}|{most:g}]", form
    factor = draw(st.sampled_from([1.0, 0.5, 0.001, 3.0, -0.35, 0.0078125, 2e-5, 1e-8]))
    lowest = -(2 ** (bits - 1)) if signed else 0
    steps = draw(st.integers(2 - 2**bits - lowest, -1 - lowest))  # both signs can be sent
    if bits > 52:
        steps = 0 if signed else -(2 ** (bits - 1))  # as a double has it
    most = draw(st.sampled_from([0.0, 0.0, 5.0])) * abs(factor)
    return f"{place} ({factor:g},{steps * factor:.17g}) [{0 - most:g}|{most:g}]", ""


def network_from(text: str, folder: Path, ids: dict[str, int] | None = None) -> Network:
    path = folder / "own.dbc"
    path.write_text(text)
    return map_network(path, Roles({**FD_SIGNALS, "verdict": "M5.Whose"}, "Count", ids or {}))


def dbc_of(lines: list[tuple[str, str]]) -> str:
    """``database`` with a value of its own in each message, and a verdict in the last."""
    text = database("{}", 16, fd=True).format(*(line for line, _ in lines))
    last = ' SG_ Fault : 14|2@1+ (1,0) [0|3] "" A\n'
    text = text.replace(last, f'{last} SG_ Whose : 35|4@0+ (1,0) [0|15] "" A\n')
    types = (
        f"SIG_VALTYPE_ {0x301 + n} Value : {kind};" for n, (_, kind) in enumerate(lines) if kind
    )
    return text + "\n".join(types) + "\n"


@pytest.mark.parametrize("precision", ["float64", "float32"])
@settings(max_examples=10, phases=[Phase.generate])  # each compiles C
@given(data=st.data(), lines=st.lists(signals(), min_size=5, max_size=5))
def test_the_bits_are_those_of_cantools(
    precision, data, lines,
    tmp_path_factory,
):  # fmt: skip
    """Both orders, signs, lengths, scales and floats; values on steps, between them and beyond."""
    text, real = dbc_of(lines), np.float32 if precision == "float32" else np.float64
    network = network_from(text, tmp_path_factory.mktemp("own"))
    theirs, code = cantools.database.load_string(text, "dbc"), frames_in_c(network, precision)
    for at, codec in enumerate(network):
        message = theirs.get_message_by_name(codec.name)
        signal = next(each for each in message.signals if each.name == "Value")
        others = {each.name: 0 for each in message.signals}
        count = data.draw(st.integers(0, 0xFFFF))
        if codec.role not in SENT:
            for payload in data.draw(st.lists(st.binary(min_size=16, max_size=16), max_size=8)):
                tick = ctypes.c_uint32()
                found = code.unpack(at, payload, ctypes.byref(tick))
                said = message.decode(payload, decode_choices=False)
                assert tick.value == said["Count"]
                value, physical = codec.decode(payload).value, float(said["Value"])  # type: ignore[arg-type]
                if codec.minimum <= physical <= codec.maximum:
                    assert value == pytest.approx(physical, abs=1e-9 * codec.lsb, rel=1e-12)
                with np.errstate(over="ignore"):
                    assert found == real(value) or (math.isnan(found) and math.isnan(value))
            continue
        for number in data.draw(
            st.lists(st.floats(allow_infinity=True, allow_nan=True), max_size=8)
        ):
            sizes = (1.0, codec.lsb or 1.0, codec.maximum / 7)
            with np.errstate(over="ignore"):
                given = float(real(number * data.draw(st.sampled_from(sizes))))
            codes = data.draw(st.integers(0, 13 << 4 | 15)) if codec.role == "status" else 0
            packed = ctypes.create_string_buffer(16)
            code.pack(at, given, count, codes, packed)
            said = (codes & 3, codes >> 2 & 3, codes >> 4)
            assert packed.raw == bytes(codec.encode(given, count, *said))
        if signal.is_float:
            continue
        most = int(min(2**20, codec.raw_maximum))
        for steps in data.draw(st.lists(st.integers(-most, most), max_size=8)):
            raw = round((steps * codec.lsb - signal.offset) / signal.scale)
            if precision == "float32" or raw > 2**50:
                continue
            packed = ctypes.create_string_buffer(16)
            code.pack(at, steps * codec.lsb, count, 0, packed)
            sent = {**others, "Value": raw, "Count": count}
            assert packed.raw == message.encode(sent, scaling=False)


def test_half_a_step_is_rounded_as_in_python(tmp_path):
    """In single precision, where 1/lsb is whole, but the division of the rig meets no half."""
    text = dbc_of([("48|32@1- (1e-05,0) [0|0]", "")] * 5)
    network = network_from(text, tmp_path)
    code, codec, odd = frames_in_c(network, "float32"), network.command_1, 0
    for value in (n / 64.0 for n in range(-999, 1000, 2)):
        packed = ctypes.create_string_buffer(16)
        code.pack(2, value, 0, 0, packed)
        assert packed.raw == bytes(codec.encode(value, 0))
        odd += codec.to_raw(value) != round(Fraction(value) * 100_000)
    assert odd > 50


# --- the node ------------------------------------------------------------------------------------

SHORT = ["duration_s=0.3", "fault.at_s=0.1"]
FD = [("64|64@1- (1,0) [0|0]", "2"), ("80|24@0- (1e-5,0) [0|0]", ""),
      ("64|37@1+ (0.001,-60000000) [0|0]", ""), ("64|32@1- (1,0) [-900|900]", "1"),
      ("71|20@0- (-0.001,0) [0|0]", "")]  # fmt: skip


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """Settings of scenarios, by the layout of their frames."""
    path, intel = (tmp_path_factory.mktemp("own") / name for name in ("fd.dbc", "intel.dbc"))
    path.write_text(dbc_of(FD))
    intel.write_text(database("32|24@1+ (0.0005,-4000) [0|0]", 8, first_id=0x98FF0000))
    verdict = {"verdict": "EPS_Status.Verdict"}
    return {
        "motorola": options(MOTOROLA, {**SIGNALS, **verdict}),
        "intel": options(intel, FD_SIGNALS, data_ids=IDS),
        "fd": options(path, {**FD_SIGNALS, "verdict": "M5.Whose"}, data_ids=IDS),
        "no tick": options(MOTOROLA, SIGNALS, tick=""),
    }


@EMULATED
@pytest.mark.parametrize(("layout", "board"), [("motorola", "m4f"), ("fd", "m7")])
def test_an_emulated_board_sends_the_same_bytes(own, layout, board):
    words = [*SHORT, *own[layout], 'design.precision="float32"']
    node = controller_of(f"arm:{board}", load("default", words))
    assert log_of("default", words) == log_of("default", words, node)


@pytest.mark.parametrize(
    ("layout", "precision"),
    [("motorola", "float64"), ("intel", "float32"), ("fd", "float64"), ("no tick", "float64")],
)
def test_any_frames_are_answered_and_judged_alike(own, layout, precision):
    words = ["duration_s=1", *own[layout], f"design.precision={precision}"]
    scenario = load("default", words)
    library, room = host_library(scenario), frame_bytes(network_of(scenario))
    for seed in range(3):
        expected, rejected = judged_alike(scenario, lambda: HostEcu(library, room), seed)
        assert rejected == expected


SENSORS = f"""{ESP12}
BO_ 1312 DRV_Echo: 5 VMC
 SG_ Force : 23|16@0- (0.5,0) [-16000|16000] "N" EPS

"""
HEARD = [
    {"measures": "yaw-rate", "period_s": 0.01, **CALM},
    {"measures": "lateral-acceleration", "period_s": 0.01, **CALM},
    {"measures": "force-difference-echo", "phase_s": 0.005, "period_s": 0.01, **CALM},
]
OSCILLATING = {
    "kind": "actuator-oscillating", "channel": "force-difference", "amplitude": 1500,
    "frequency_rad_per_s": 10, "at_s": 0.4,
}  # fmt: skip
DEAD = {"kind": "sensor-dead", "at_s": 0.3}


@pytest.mark.parametrize(
    ("precision", "fault", "others"),
    [("float64", OSCILLATING, HEARD[:2]), ("float32", DEAD, HEARD[2:])],
    ids=["echo", "witness"],
)
def test_sensors_are_heard_in_the_units_of_the_database(tmp_path, precision, fault, others):
    """A message carries two sensors, one of them mirrored; no sensors, another answer."""
    path = tmp_path / "car.dbc"
    path.write_text(MOTOROLA.read_text().replace("BO_ 1304", f"{SENSORS}BO_ 1304"))
    roles = {"yaw_rate": "ESP12.YAW_RATE", "lateral_acceleration": "ESP12.LAT_ACCEL",
             "force_difference_echo": {"signal": "DRV_Echo.Force", "factor": -0.5}}  # fmt: skip
    values = {
        "duration_s": 0.8, "latency_ticks": 1, "design": {"precision": precision}, "fault": fault,
        "network": {"dbc": str(path), "tick": "Count", "signals": {**SIGNALS, **roles}},
    }  # fmt: skip
    all_of_them, fewer = (
        load_values("sensed", {**values, "sensor": heard}) for heard in (HEARD, others)
    )
    python = log_from(all_of_them)
    assert python == log_from(all_of_them, controller_of("ecu", all_of_them))
    answers = (re.findall(rb" 51[567]#\w+", log) for log in (python, log_from(fewer)))
    assert next(answers) != next(answers)


# --- the export ----------------------------------------------------------------------------------


def test_an_export_compiles_and_repeats_itself(own, tmp_path):
    for layout in ("fd", "no tick"):
        words = [w for word in own[layout] for w in ("--set", word)]
        first, again = tmp_path / f"{layout} 1", tmp_path / f"{layout} 2"
        for scenario, place in (("default", first), (str(first / "default.toml"), again)):
            chosen = words if place == first else []
            succeeded("export", scenario, *chosen, "--out", place)
        for each in first.iterdir():
            assert each.read_bytes() == (again / each.name).read_bytes(), each.name
        run("sha256sum", "--check", "--quiet", "manifest.sha256", cwd=first)
        flags = f"CFLAGS={' '.join(STRICT)} -O2"
        run("make", "-s", "-C", first, flags, "example", "bench")


def test_a_signal_that_cannot_be_exported_is_one_line(tmp_path):
    text = dbc_of([("64|16@1- (1,0) [0|0]", "")] * 5)
    path = tmp_path / "own.dbc"
    path.write_text(text + "SIG_VALTYPE_ 771 Value : 1;\n")
    words = options(path, {**FD_SIGNALS, "verdict": "M5.Whose"})
    with pytest.raises(ExportError) as caught:
        application(load("default", words))
    assert str(caught.value) == (
        f"{path}: message M3: signal Value is a float of 16 bits: must have 32 or 64 bits in the "
        "ECU in C"
    )
