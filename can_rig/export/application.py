"""The whole controller node in C, and a folder with its build files."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Final

from can_rig.drawing.names import Signal, names_of
from can_rig.errors import ExportError
from can_rig.export.c_files import comment, constants_files, plain
from can_rig.export.law import HEARS, SENSORS, SINGLE, law_files, numbers_of, parts_of, support
from can_rig.export.prefix import with_prefix
from can_rig.export.provenance import with_provenance
from can_rig.export.self_test import DATA, self_test_data
from can_rig.folders import Kind, refuse_folder, whole_folder
from can_rig.frames.codec import MessageCodec, RigLayout
from can_rig.frames.network import Network
from can_rig.scenario.build import dbc_of, network_of, require_ours
from can_rig.scenario.controls import controls
from can_rig.scenario.sensor_settings import HEARD
from can_rig.scenario.settings import Scenario
from firmware_model.law.structs import Precision

HEADER: Final = "firmware.h"
"""Public header of every export, for inclusion by an application."""

BY_HAND: Final = (
    "firmware.c", "crc.h", "crc.c", "self_test.h", "self_test.c", "e2e.h", "e2e.c", "frames.h",
    "frames.c", "ecu.h", "ecu.c",
)  # fmt: skip
BENCH: Final = ("bench.h", "bench.c", "harness.h", "harness.c")
BUILD_FILES: Final = ("Makefile", "CMakeLists.txt", "main.c", "bench_main.c", "check.c")
EVIDENCE: Final = ("evidence.json", "evidence.html")
"""Files beside the export, about it; an export without them removes those of an earlier one."""
IDENTITY_BYTES: Final = 8


def application(scenario: Scenario) -> dict[str, str]:
    """Text by file name: everything except the CAN driver, which provides ``ecu_send``.

    Raises:
        ScenarioError: the design fails.
        ExportError: the law uses syntax outside the C subset, or the frames come from another
            database.
    """
    require_ours(scenario, "the control law as C")
    network = network_of(scenario)
    if not network.is_the_rigs:
        raise ExportError(
            f"network.dbc = {scenario.network.dbc!r}: must be left out, for the ECU in C has the "
            "rig's own frames; run --controller c runs the law in C on yours"
        )
    of, names = controls(scenario, network), names_of(scenario.plant)
    limits, precision = scenario.limits, scenario.design.precision
    title = f"The constants of the controller of scenario {scenario.name}."
    law = law_files(precision, of.schedule is not None)
    parts = {*parts_of(law), *((HEARS,) if network.speed else ())}
    sensors = _sensors(scenario, network)
    parts |= {SENSORS} if sensors else set()
    parts |= {SINGLE} if precision == "float32" else set()
    header = support(
        HEADER,
        parts,
        speed=_signal(network.speed) if network.speed else "",
        scenario=plain(scenario.name),
        tick=f"{scenario.tick_s * 1e3:g} ms",
        latency=_latency(scenario),
        command_1=_signal(network.command_1, names.command_1, limits.torque_nm),
        command_2=_signal(network.command_2, names.command_2, limits.force_difference_n),
        estimate=_signal(network.status, names.output._replace(name="")),
        reference=_signal(network.reference, names.output._replace(name="")),
        measurement=_signal(network.feedback, names.output),
    )
    texts = {**numbers_of(precision), "sensors": str(len(sensors))}
    return {
        **law,
        **constants_files(of.table, title, of.schedule),
        HEADER: header,
        **{name: support(name, parts, **texts) for name in BY_HAND},
        DATA: self_test_data(of, scenario.reference.amplitude_mps2 or 1.0, bool(sensors)),
        "network.c": _network_source(network, scenario),
    }


def bench(node: Mapping[str, str]) -> dict[str, str]:
    """The files of a node that answers a bench over a link: text by file name.

    Args:
        node: of ``application``.
    """
    numbers = ", ".join(f"0x{byte:02X}" for byte in identity(node))
    return {name: support(name, _parts(node), identity=numbers) for name in BENCH}


def identity(node: Mapping[str, str]) -> bytes:
    """Identity of a controller: 8 bytes, a hash of its ``application`` without comments."""
    code = {name: re.sub(r"/\*.*?\*/", "", text, flags=re.S) for name, text in node.items()}
    return hashlib.sha256(repr(sorted(code.items())).encode()).digest()[:IDENTITY_BYTES]


def exported(scenario: Scenario, prefix: str | None = None) -> dict[str, str]:
    """The whole of a scenario's controller as text by file name.

    Args:
        scenario: the scenario.
        prefix: of ``with_prefix``; None: the names as they are.

    Raises:
        ScenarioError: the design fails.
        ExportError: the law is outside the subset that becomes C, or not a prefix.
    """
    node = application(scenario)
    units = sorted(name for name in node if name.endswith(".c"))
    texts = {
        **numbers_of(scenario.design.precision),
        "objects": " \\\n    ".join(f"{name.removesuffix('.c')}.o" for name in units),
        "sources": "\n".join(f"  {name}" for name in units),
        "prefix": f"{prefix}_" if prefix else "",
    }
    build = {name: support(name, _parts(node), **texts) for name in BUILD_FILES}
    whole = {**node, **bench(node), **build}
    return with_provenance(whole if prefix is None else with_prefix(whole, prefix), scenario)


def in_precision(scenario: Scenario, precision: Precision) -> Scenario:
    """The scenario with another precision of the controller."""
    return replace(scenario, design=replace(scenario.design, precision=precision))


def write(texts: dict[str, str], folder: Path, force: bool) -> None:
    """Write all files, or none; ``force`` replaces files of an earlier export.

    Foreign files in the folder, such as a driver or build products, stay.

    Raises:
        RunFolderError: the folder exists and is not to be written to, or cannot be written.
    """
    own = {*texts, *EVIDENCE}
    kind = Kind("an exported controller", HEADER, lambda _: own, lambda _: True)
    refuse_folder(folder, kind, force)
    with whole_folder(folder, kind, force=force) as made:
        for name, text in texts.items():
            (made / name).write_text(text, encoding="utf-8")


def _parts(node: Mapping[str, str]) -> set[str]:
    """Parts of handwritten files that go with the files of an application."""
    return {*parts_of(node), *((HEARS,) if "frame_speed" in node["frames.h"] else ())}


def _network_source(network: Network, scenario: Scenario) -> str:
    """``network.c``: the DBC's properties of each frame, and the period."""
    lines = [*comment(f"The frames of {dbc_of(scenario).name}."), '#include "ecu.h"', ""]
    lines.append(f"const uint32_t ecu_tick_us = {round(scenario.tick_s * 1e6)};")
    for codec in network.by_role:
        lines += ["", *comment(f"{codec.name}: {_signal(codec)}")]
        lines += [f"const struct frame frame_{codec.role} = {{", *_numbers(codec), "};"]
    if sensors := _sensors(scenario, network):
        lines += ["", "const struct ecu_sensor_frame ecu_sensors[ECU_SENSORS] = {"]
        for number, codec, (period, phase, _) in sensors:
            lines += [f"    {each}" for each in comment(f"{codec.name}: {_signal(codec)}")]
            lines += [
                "    {",
                "        .frame = {",
                *(f"        {each}" for each in _numbers(codec)),
            ]
            lines.append("        },")
            lines.append(f"        .number = {number}, .period = {period}u, .phase = {phase}u,")
            lines.append("    },")
        lines.append("};")
    return "\n".join(lines) + "\n"


def _sensors(
    scenario: Scenario, network: Network
) -> list[tuple[int, MessageCodec, tuple[int, int, int]]]:
    """Number, frame and timing of each sensor that the law hears."""
    return [
        (HEARD.index(sensor.measures) + 1, codec, sensor.timing(scenario.tick_s))
        for sensor, codec in zip(scenario.sensors, network.witnesses, strict=True)
        if sensor.measures in scenario.heard
    ]


def _numbers(codec: MessageCodec) -> list[str]:
    """The initialisers of a ``struct frame``."""
    numbers = {
        "id": f"0x{codec.frame_id:X}",
        "data_id": f"0x{codec.data_id:X}",
        "lsb": repr(codec.lsb),
        "steps_per_unit": f"{_steps_per_unit(codec)}u",
        "raw_maximum": str(codec.raw_maximum),
    }
    if codec.modes and isinstance(codec.layout, RigLayout):
        numbers["mode_shift"], numbers["fault_state_shift"] = map(str, codec.layout.shifts)
        numbers["verdict_bits"] = str(codec.layout.verdict_bits)
    return [f"    .{name} = {value}," for name, value in numbers.items()]


def _steps_per_unit(codec: MessageCodec) -> int:
    """1/lsb, which frames of a DBC of the rig have as a whole number, with a range around zero."""
    steps = 1 / Fraction(repr(codec.lsb))
    assert steps.denominator == 1 and steps < 1 << 27 and codec.raw_maximum < 2**23 * steps
    assert codec.raw_minimum == -codec.raw_maximum
    return int(steps)


def _signal(codec: MessageCodec, signal: Signal | None = None, limit: float | None = None) -> str:
    """Unit, meaning and range of a frame's only signal, for the plant.

    ``limit`` bounds a command, though the frame could express more.
    """
    unit, name = codec.unit, codec.signal_name
    if signal is not None:
        unit = signal.unit
        name = f"{signal.name} ({name})" if signal.name else name
    most = codec.maximum if limit is None else min(limit, codec.maximum)
    least = codec.minimum if limit is None else max(-limit, codec.minimum)
    said = f"[{unit}] {name}" if unit else name
    return plain(f"{said}, {least:.10g}..{most:.10g}, steps of {codec.lsb:g}")


def _latency(scenario: Scenario) -> str:
    n = scenario.latency_ticks
    if n == 0:
        return "at once"
    return f"{n} tick{'s' if n > 1 else ''} ({n * scenario.tick_s * 1e3:g} ms) later"
