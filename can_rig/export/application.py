"""The whole controller node in C, and a folder with its build files."""

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from can_rig.drawing.names import names_of
from can_rig.export.c_files import constants_files, plain
from can_rig.export.law import (
    HEARS,
    SENSORS,
    SINGLE,
    check_declarations,
    law_files,
    numbers_of,
    parts_of,
    support,
)
from can_rig.export.network_code import NetworkCode, sensors_of, signal_comment
from can_rig.export.prefix import with_prefix
from can_rig.export.provenance import as_bytes, with_provenance
from can_rig.export.self_test import DATA, self_test_data
from can_rig.scenario.build import network_of, require_ours
from can_rig.scenario.controls import controls
from can_rig.scenario.settings import Scenario
from can_rig.storage.folders import Kind, refuse_folder, whole_folder
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
ORDER_HEAD, SENT_HEAD = 6, 5
"""Bytes before the data of a frame, in an order of the bench and in an answer."""


def application(scenario: Scenario) -> dict[str, str]:
    """Text by file name: everything except the CAN driver, which provides ``ecu_send``.

    Raises:
        ScenarioError: the design fails.
        ExportError: the law uses syntax outside the C subset, or a signal cannot be exported.
    """
    require_ours(scenario, "the control law as C")
    check_declarations()
    network = network_of(scenario)
    code = NetworkCode(scenario, network)
    of, names = controls(scenario, network), names_of(scenario.plant)
    limits, precision = scenario.limits, scenario.design.precision
    title = f"The constants of the controller of scenario {scenario.name}."
    law = law_files(precision, of.schedule is not None)
    parts = {*parts_of(law), *((HEARS,) if network.speed else ()), *code.parts}
    sensors = sensors_of(scenario, network)
    parts |= {SENSORS} if sensors else set()
    parts |= {SINGLE} if precision == "float32" else set()
    header = support(
        HEADER,
        parts,
        speed=signal_comment(network.speed) if network.speed else "",
        scenario=plain(scenario.name),
        tick=f"{scenario.tick_s * 1e3:g} ms",
        latency=_latency(scenario),
        command_1=signal_comment(network.command_1, names.command_1, limits.torque_nm),
        command_2=signal_comment(network.command_2, names.command_2, limits.force_difference_n),
        estimate=signal_comment(network.status, names.output._replace(name="")),
        reference=signal_comment(network.reference, names.output._replace(name="")),
        measurement=signal_comment(network.feedback, names.output),
    )
    texts = {**numbers_of(precision), **code.texts}
    return {
        **law,
        **constants_files(of.table, title, of.schedule),
        HEADER: header,
        **{name: support(name, parts, **texts) for name in BY_HAND},
        DATA: self_test_data(of, scenario.reference.amplitude_mps2 or 1.0, bool(sensors)),
        "network.c": code.source(),
    }


def bench(node: Mapping[str, str]) -> dict[str, str]:
    """The files of a node that answers a bench over a link: text by file name.

    Args:
        node: of ``application``.
    """
    numbers = ", ".join(f"0x{byte:02X}" for byte in identity(node))
    (room,) = re.findall(r"#define FRAME_BYTES (\d+)u", node["frames.h"])
    sizes = {"order_bytes": str(ORDER_HEAD + int(room)), "sent_bytes": str(SENT_HEAD + int(room))}
    return {name: support(name, parts_of(node), identity=numbers, **sizes) for name in BENCH}


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
    build = {name: support(name, parts_of(node), **texts) for name in BUILD_FILES}
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
    refuse_export(folder, force)
    with whole_folder(folder, _kind(texts), force=force) as made:
        for name, text in texts.items():
            (made / name).write_bytes(as_bytes(text))


def refuse_export(folder: Path, force: bool) -> None:
    """Refuse a folder that ``write`` would refuse, before the translation.

    Raises:
        RunFolderError: the reason.
    """
    refuse_folder(folder, _kind(()), force)


def _kind(names: Iterable[str]) -> Kind:
    """A folder with the files ``names``."""
    own = {*names, *EVIDENCE}
    return Kind("an exported controller", HEADER, lambda _: own, lambda _: True)


def _latency(scenario: Scenario) -> str:
    n = scenario.latency_ticks
    if n == 0:
        return "at once"
    return f"{n} tick{'s' if n > 1 else ''} ({n * scenario.tick_s * 1e3:g} ms) later"
