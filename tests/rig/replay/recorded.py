"""The recorded drives of ``tests/drives``: scenario, log, and the constants of the controller.

Another processor's linear algebra rounds otherwise, so the constants of one design differ in their
last bits from host to host. With the recorded ones every host must answer with the recorded bits.
"""

import tomllib
from pathlib import Path
from typing import Any, Final

import numpy as np

from can_rig.controllers.our_law import in_node
from can_rig.logs.reading import read_log
from can_rig.replaying.replay import OpenLoop
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controls
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import PYTHON_LAW, ChangeSpeed, Hear, Law, Memories, Step
from firmware_model.law.layout import State, Table
from firmware_model.law.structs import Records

FOLDER: Final = Path(__file__).parents[2] / "drives"
DRIVES: Final[dict[str, dict[str, Any]]] = tomllib.loads(
    (FOLDER / "drives.toml").read_text("utf-8")
)
HOSTS_DIFFER: Final = 1e-7
"""By how much of the largest number of its field a constant may differ: 5e-9 was seen."""


def scenario_of(name: str, *settings: str) -> Scenario:
    """The scenario of a drive, with further settings."""
    return load(DRIVES[name]["scenario"], [*DRIVES[name]["set"], *settings])


def log_of(name: str) -> Path:
    """The log of a drive."""
    return FOLDER / f"{name}.log.gz"


def designed(scenario: Scenario) -> dict[str, Any]:
    """The constants of today's design on this host: its table and, of many speeds, its schedule."""
    of = controls(scenario, network_of(scenario))
    return {"table": of.table} | ({} if of.schedule is None else {"schedule": of.schedule})


def recorded(name: str) -> dict[str, Any]:
    """The constants that the controller of a drive had."""
    with np.load(_constants(name)) as file:
        return {part: file[part][()] for part in file.files}


def has_constants(name: str) -> bool:
    """Whether the constants of a drive are there."""
    return _constants(name).exists()


def keep(name: str, constants: dict[str, Any]) -> None:
    """Write the constants of a drive."""
    np.savez_compressed(_constants(name), allow_pickle=False, **constants)


def are_close(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether constants have the same fields, and the same values but for rounding."""
    return one.keys() == other.keys() and all(
        one[part].dtype == other[part].dtype and _close(one[part], other[part]) for part in one
    )


def replayed(name: str, scenario: Scenario, law: Law) -> OpenLoop:
    """A drive through the controller of ``scenario``, run by ``law``."""
    loop = OpenLoop(scenario, network_of(scenario), controller=in_node(law))
    loop.run(read_log(log_of(name)))
    return loop


class WithRecordedConstants:
    """A law that runs from the constants of a drive; see ``firmware_model.firmware.Law``."""

    def __init__(self, name: str) -> None:
        self._constants = recorded(name)
        self._law = PYTHON_LAW

    def init(self, table: Any) -> Records[State]:
        """See ``Law``."""
        constants = self._constants["table"]
        for field in table.dtype.fields or ():
            table[field] = constants[field]
        return self._law.init(table)

    def step_of(self, tables: Records[Table], states: Records[State]) -> Step:
        """See ``Law``."""
        return self._law.step_of(tables, states)

    def hear_of(self, tables: Records[Table], states: Records[State]) -> Hear:
        """See ``Law``."""
        return self._law.hear_of(tables, states)

    def reset(self, table: Any, state: Any, reference: float) -> None:
        """See ``Law``."""
        self._law.reset(table, state, reference)

    def change_speed_of(self, memories: Memories) -> ChangeSpeed:
        """See ``Law``."""
        memories[0][0] = self._constants["schedule"]
        return self._law.change_speed_of(memories)


def _constants(name: str) -> Path:
    return FOLDER / f"{name}.constants.npz"


def _close(one: Any, other: Any) -> bool:
    if one.dtype.names:
        return all(_close(one[field], other[field]) for field in one.dtype.names)
    if not np.issubdtype(one.dtype, np.floating):
        return np.array_equal(one, other)
    finite = np.abs(one)[np.isfinite(one)]
    return np.allclose(one, other, rtol=0.0, atol=HOSTS_DIFFER * np.max(finite, initial=0.0))
