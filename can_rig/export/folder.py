"""A folder of C: a scenario's controller, and what builds it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

from can_rig.errors import LogError
from can_rig.export.application import application
from can_rig.export.law import filled, support
from can_rig.export.running.ecu import bench
from can_rig.export.speed_words import words_of
from can_rig.files import atomic, refuse_existing
from can_rig.scenario.settings import Scenario
from firmware_model.target.structs import Precision

HEADER: Final = "firmware.h"
"""Of every export: what an application includes."""

BUILD_FILES: Final = ("Makefile", "CMakeLists.txt", "main.c", "bench_main.c")


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
    """The scenario with a controller of that precision."""
    return replace(scenario, design=replace(scenario.design, precision=precision))


def write(files: dict[str, str], folder: Path, force: bool) -> None:
    """Write all of them, or none; with ``force`` over those of an earlier export.

    What else is in that folder, a driver or what make has built, stays.

    Raises:
        LogError: the folder exists and is not to be written to, or cannot be written.
    """
    refuse_existing(folder, force, "--out")
    if folder.exists():
        _require_export(folder)
        for name, text in files.items():
            with atomic(folder / name) as part:
                part.write_text(text, encoding="utf-8")
        return
    with atomic(folder) as part:
        part.mkdir()
        for name, text in files.items():
            (part / name).write_text(text, encoding="utf-8")


def _require_export(folder: Path) -> None:
    """Refuse a folder that holds something, but no controller of an earlier export."""
    try:
        names = {path.name for path in folder.iterdir()}
    except OSError as error:
        raise LogError(f"{folder}: cannot be read: {error.strerror}") from None
    if names and HEADER not in names:
        raise LogError(f"{folder}: no exported controller, so --force does not write into it")
