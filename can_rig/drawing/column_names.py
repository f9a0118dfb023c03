"""Names of the columns of ``signals.csv``, derived from the plant's signals and units.

Within the rig every plant has the columns of the car (``logs.columns``). In the file, ``torque_nm``
must be a torque in N m, so for any other plant the columns have the names and units of the
scenario's signals.
"""

from __future__ import annotations

import re
from collections.abc import Container, Sequence
from typing import Final

from can_rig.drawing.names import CAR, names_of
from can_rig.logs.columns import APPLIED, EVIDENCE, EVIDENCE_OF, TAKEN, TRUE_OUTPUT
from can_rig.scenario.plant_settings import PlantSettings

OF_CAR: Final = {
    CAR.output: ("dstar", "_mps2"),
    CAR.command_1: ("torque", "_nm"),
    CAR.command_2: ("force_difference", "_n"),
}
"""Stem and ending of the columns of the car's signals."""

ROLES: Final = ("output", "input_1", "input_2")
"""Stems where the names are no good: no ASCII letter, or a duplicate column name."""

UNIT_WORDS: Final = {"%": "percent", "°": "deg", "²": "2", "³": "3", "µ": "u", "Ω": "ohm"}


def column_names(plant: PlantSettings, further: Container[str] = ()) -> dict[str, str]:
    """The name in the file of each column with a signal of ``plant``, by the car's name.

    Args:
        plant: the plant.
        further: further names in use: a user's plant may report any signal.
    """
    signals = names_of(plant)
    endings = [OF_CAR[each][1] if each in OF_CAR else _ending(each.unit) for each in signals]
    stems = [OF_CAR[each][0] if each in OF_CAR else _word(each.name) for each in signals]
    names = _columns(stems, endings)
    others = set(TAKEN) - set(names)
    if not all(stems) or len({*names.values()} - others) < len(names):
        names = _columns(ROLES, endings)
    return {column: column if name in further else name for column, name in names.items()}


def _columns(stems: Sequence[str], endings: Sequence[str]) -> dict[str, str]:
    output, *commands = (stem + ending for stem, ending in zip(stems, endings, strict=True))
    command_1, command_2 = commands
    return {
        "reference_mps2": f"reference{endings[0]}",
        "dstar_mps2": output,
        "error_mps2": f"error{endings[0]}",
        "torque_nm": command_1,
        "force_difference_n": command_2,
        "fault_estimate_mps2": f"fault_estimate{endings[0]}",
        TRUE_OUTPUT: f"true_{output}",
        APPLIED[0]: f"applied_{command_1}",
        APPLIED[1]: f"applied_{command_2}",
        **{column: _evidence(column, stems) for column in EVIDENCE},
    }


def _evidence(column: str, stems: Sequence[str]) -> str:
    """The evidence for the failure of an actuator, by its name; for the car, unchanged."""
    of, _, failed = column.removeprefix(EVIDENCE_OF).partition("_")
    stem = {"torque": stems[1], "force": stems[2]}.get(of, of)
    return f"{EVIDENCE_OF}{'force' if stem == OF_CAR[CAR.command_2][0] else stem}_{failed}"


def _ending(unit: str) -> str:
    """``mol/s`` as ``_mol_per_s``, ``N m`` as ``_nm``; empty without a unit."""
    for sign, word in UNIT_WORDS.items():
        unit = unit.replace(sign, word)
    parts = [_word(part).replace("_", "") for part in unit.split("/")]
    return "_" + "_per_".join(parts) if all(parts) else ""


def _word(text: str) -> str:
    """``text`` in small letters, digits and _."""
    return re.sub("[^0-9a-z]+", "_", text.lower()).strip("_")
