"""The reference that D* shall follow, one value a tick."""

from __future__ import annotations

import numpy as np

from can_rig.errors import ScenarioError
from can_rig.scenario import Scenario
from firmware_model.sections import FloatArray


def reference(scenario: Scenario) -> FloatArray:
    """r at every tick of the run, shape (ticks,), m/s².

    Raises:
        ScenarioError: a CSV that cannot be read, or whose times do not increase.
    """
    settings = scenario.reference
    time_s = np.arange(scenario.ticks) * (scenario.tick_ns * 1e-9)
    if settings.kind == "step":
        return np.full(scenario.ticks, settings.amplitude_mps2)
    if settings.kind == "sine":
        return settings.amplitude_mps2 * np.sin(settings.frequency_rad_per_s * time_s)
    return _from_csv(scenario, time_s)


def _from_csv(scenario: Scenario, time_s: FloatArray) -> FloatArray:
    """Linear between the CSV's rows (time_s, reference_mps2), its ends held; a header may lead."""
    where = f"scenario {scenario.name}: reference.file = {scenario.reference.file!r}"
    try:
        with open(scenario.reference.file, encoding="utf-8") as file:  # noqa: PTH123
            lines = [line for line in file if line.strip() and not line.startswith("#")]
        if lines and not lines[0].lstrip()[:1].lstrip("+-.").isdigit() and lines[0][0].isalpha():
            lines = lines[1:]
        rows = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise ScenarioError(f"{where}: {error}") from None
    if rows.ndim != 2 or rows.shape[1] != 2 or not np.isfinite(rows).all():
        raise ScenarioError(f"{where}: rows of two finite numbers, time_s,reference_mps2, are right")
    if not (np.diff(rows[:, 0]) > 0).all():
        raise ScenarioError(f"{where}: times that increase from row to row are right")
    values: FloatArray = np.interp(time_s, rows[:, 0], rows[:, 1])
    return values * 1.0
