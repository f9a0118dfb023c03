"""The network of a scenario: the user's database, and the roles of its signals."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Final

from pydantic import Field
from pydantic.dataclasses import dataclass

from can_rig.scenario.stage_settings import STRICT

DataId = Annotated[int, Field(ge=1, le=0xFFFF)]
"""Of AUTOSAR E2E profile 1."""
OPTIONAL: Final = ("mode", "fault_state", "verdict")


class _Names:
    """Names by key: all except those in ``OPTIONAL``, or an empty table."""

    def _given(self) -> dict[str, str]:
        return vars(self)

    def __bool__(self) -> bool:
        """Whether any name is given."""
        return any(self._given().values())

    def _require_all(self, others: str) -> None:
        if not self:
            return
        for key, name in self._given().items():
            if not name and key not in OPTIONAL:
                raise ValueError(f"{key}: must be set beside the other {others}")


@dataclass(frozen=True, config=STRICT)
class SignalNames(_Names):
    """The signal of each role, as ``Message.Signal``; all except the last three are required."""

    reference: str = ""
    feedback: str = ""
    command_1: str = ""
    command_2: str = ""
    fault_estimate: str = ""
    mode: str = ""
    fault_state: str = ""
    verdict: str = ""

    def __post_init__(self) -> None:
        for key, name in self._given().items():
            message, dot, signal = name.partition(".")
            if name and not (message and dot and signal):
                raise ValueError(f"{key} = {name!r}: must be Message.Signal")
        self._require_all("signals, as Message.Signal")


@dataclass(frozen=True, config=STRICT)
class TickNames(_Names):
    """The tick-counting signal in each role's message: for all roles or no role."""

    reference: str = ""
    feedback: str = ""
    command_1: str = ""
    command_2: str = ""
    status: str = ""

    def __post_init__(self) -> None:
        self._require_all("ticks")


@dataclass(frozen=True, config=STRICT)
class DataIds:
    """E2E data identifiers of messages with profile 1 protection, by role."""

    reference: DataId | None = None
    feedback: DataId | None = None
    command_1: DataId | None = None
    command_2: DataId | None = None
    status: DataId | None = None


@dataclass(frozen=True, config=STRICT)
class NetworkSettings:
    """The user's frames in place of the rig's.

    ``dbc`` is any database that cantools reads. With ``signals``, the database's frames are used
    unchanged; without ``signals``, the database must have RigRole and the rig's layout. ``tick``
    names the tick-counting signal common to all five messages; ``ticks`` gives a name for each
    message; without both, no message counts ticks.
    """

    dbc: str = ""
    tick: str = ""
    ticks: TickNames = dataclasses.field(default_factory=TickNames)
    signals: SignalNames = dataclasses.field(default_factory=SignalNames)
    data_ids: DataIds = dataclasses.field(default_factory=DataIds)

    def __post_init__(self) -> None:
        if self.signals and not self.dbc:
            raise ValueError("dbc: must name the database of network.signals")
        if self.tick and self.ticks:
            raise ValueError("ticks: must not be set beside network.tick")
        others = (
            self.tick
            or self.ticks
            or any(number is not None for number in vars(self.data_ids).values())
        )
        if others and not self.signals:
            raise ValueError("signals: must be set beside network.tick, ticks and data_ids")
