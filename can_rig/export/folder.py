"""A folder of C: a scenario's controller, and its build files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

from can_rig.export.application import application
from can_rig.export.law import filled, support
from can_rig.export.running.ecu import bench
from can_rig.export.speed_words import words_of
from can_rig.folders import Kind, refuse_folder, whole_folder
from can_rig.scenario.settings import Scenario
from firmware_model.target.structs import Precision

HEADER: Final = "firmware.h"
"""Public header of every export, for inclusion by an application."""

BUILD_FILES: Final = ("Makefile", "CMakeLists.txt", "main.c", "bench_main.c")


def exported(scenario: Scenario, precision: Precision | None = None) -> dict[str, str]:
    """The whole of a scenario's controller as text by file name.

    Args:
        scenario: the scenario.
        precision: of its real numbers; None: the scenario's.

    Raises:
        ScenarioError: the design fails.
        ExportError: the law is outside the subset that becomes C.
    """
    chosen = scenario if precision is None else in_precision(scenario, precision)
    files = application(chosen)
    units = sorted(name for name in files if name.endswith(".c"))
    zero = "0.0f" if chosen.design.precision == "float32" else "0.0"
    objects = " \\\n    ".join(f"{name.removesuffix('.c')}.o" for name in units)
    sources = "\n".join(f"  {name}" for name in units)
    return {**files, **bench(files)} | {
        name: filled(
            support(name),
            zero=zero,
            objects=objects,
            sources=sources,
            **words_of(files),
        )
        for name in BUILD_FILES
    }


def in_precision(scenario: Scenario, precision: Precision) -> Scenario:
    """The scenario with another precision of the controller."""
    return replace(scenario, design=replace(scenario.design, precision=precision))


def write(files: dict[str, str], folder: Path, force: bool) -> None:
    """Write all files, or none; ``force`` replaces files of an earlier export.

    Foreign files in the folder, such as a driver or build products, stay.

    Raises:
        RunFolderError: the folder exists and is not to be written to, or cannot be written.
    """
    kind = Kind("an exported controller", HEADER, lambda _: files, lambda _: True)
    refuse_folder(folder, kind, force)
    with whole_folder(folder, kind, force=force) as made:
        for name, text in files.items():
            (made / name).write_text(text, encoding="utf-8")
