"""A folder of C: the law, the constants of a scenario, and what builds them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

from can_rig.export.constants import constants_header, constants_source
from can_rig.export.law import filled, law_files, support
from can_rig.files import atomic, refuse_existing
from can_rig.frames.codec import MessageCodec
from can_rig.scenario.build import controller_table, network_of
from can_rig.scenario.settings import Scenario
from firmware_model.target.structs import Precision

BUILD_FILES: Final = ("Makefile", "CMakeLists.txt", "main.c")


def exported(scenario: Scenario, precision: Precision | None = None) -> dict[str, str]:
    """The whole of a scenario's controller as text by file name.

    Args:
        scenario: whose controller it is.
        precision: of its real numbers; None: the scenario's.

    Raises:
        ScenarioError: a design that cannot be made.
        ExportError: the law is outside the subset that becomes C.
    """
    chosen = scenario if precision is None else in_precision(scenario, precision)
    network = network_of(chosen)
    table = controller_table(chosen, network)
    title = f"The constants of the controller of scenario {chosen.name}."
    files = {
        **law_files(chosen.design.precision),
        "constants.h": constants_header(title),
        "constants.c": constants_source(table, title),
        "firmware.h": filled(
            support("firmware.h"),
            scenario=chosen.name,
            tick=f"{chosen.tick_s * 1e3:g} ms",
            latency=_latency(chosen),
            command_1=_signal(network.command_1),
            command_2=_signal(network.command_2),
            estimate=_signal(network.status),
            reference=_signal(network.reference),
            measurement=_signal(network.feedback),
        ),
        "firmware.c": support("firmware.c"),
    }
    units = sorted(name for name in files if name.endswith(".c"))
    zero = "0.0f" if chosen.design.precision == "float32" else "0.0"
    objects = " \\\n    ".join(f"{name.removesuffix('.c')}.o" for name in units)
    sources = "\n".join(f"  {name}" for name in units)
    files |= {
        name: filled(support(name), zero=zero, objects=objects, sources=sources)
        for name in BUILD_FILES
    }
    return files


def in_precision(scenario: Scenario, precision: Precision) -> Scenario:
    """The scenario with a controller of that precision."""
    return replace(scenario, design=replace(scenario.design, precision=precision))


def write(files: dict[str, str], folder: Path, force: bool) -> None:
    """Write all of them, or none.

    Raises:
        LogError: the folder exists and must not be replaced, or cannot be written.
    """
    refuse_existing(folder, force, "--out")
    with atomic(folder) as part:
        part.mkdir()
        for name, text in files.items():
            (part / name).write_text(text, encoding="utf-8")


def _signal(codec: MessageCodec) -> str:
    """Unit, meaning and range of the one signal of a frame."""
    unit = f"[{codec.unit}] " if codec.unit else ""
    return (
        f"{unit}{codec.signal_name}, {codec.minimum:g}..{codec.maximum:g}, steps of {codec.lsb:g}"
    )


def _latency(scenario: Scenario) -> str:
    n = scenario.latency_ticks
    if n == 0:
        return "at once"
    return f"{n} tick{'s' if n > 1 else ''} ({n * scenario.tick_s * 1e3:g} ms) later"
