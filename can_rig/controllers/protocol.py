"""What a node asks of a controller: inputs of a tick in, an answer out.

A node either steps a controller itself (`InNode`) or passes frames to a program that is a whole
node (`WholeNode`).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple, Protocol

from can_rig.frames.codec import AGE, NO_DECISION, NO_VERDICT, USABLE, CheckStatus
from can_rig.frames.network import Network
from can_rig.scenario.sensor_settings import HEARD, USUAL
from can_rig.scenario.settings import Scenario
from firmware_model.law.status import FaultState, Mode

LISTEN_S: Final = 0.05
"""A controller that starts while the plant moves listens for so long before it sends commands."""

RUN, CANNOT_TELL = int(Mode.RUN), int(FaultState.CANNOT_TELL)

HEARD_COLUMNS: Final = tuple(USUAL[measured].column for measured in HEARD)
NO_WITNESSES: Final[Mapping[str, float]] = MappingProxyType({})


class Inputs(NamedTuple):
    """What a tick brings; a value that has not come is not a number."""

    reference: float
    """The wanted output, in the unit of the measurement."""
    measurement: float
    """The measured output: D* of a car, m/s²."""
    speed_mps: float = math.nan
    """The speed of the car, where the scenario has a drive."""
    witnesses: Mapping[str, float] = NO_WITNESSES
    """Further sensors by the names of their columns, as in ``yaw_rate_rad_per_s``."""


def ages_of(columns: Sequence[str]) -> list[str]:
    """The columns of the ages of what the rig's own law hears, among ``columns``."""
    return [name + AGE for name in columns if name in HEARD_COLUMNS]


def samples_in(heard: Mapping[str, float]) -> list[tuple[int, float, float]]:
    """Number, value and age in ticks of each sample among the witnesses of a tick.

    The arguments of ``further_sensors.hear``.
    """
    if not heard:
        return []
    return [
        (number, value, age if (age := heard[name + AGE]) == age else 0.0)
        for number, name in enumerate(HEARD_COLUMNS, 1)
        if not math.isnan(value := heard.get(name, math.nan))
    ]


class Answer(NamedTuple):
    """What a controller answers; None: the controller does not say."""

    command_1: float
    """To channel 1: the torque of the steering motor of a car, N m."""
    command_2: float
    """To channel 2: the difference of the rear driving forces of a car, N."""
    fault_estimate: float | None = None
    """d̂: what the fault takes from the output, in the unit of the measurement."""
    mode: int | None = None
    """A ``Mode``."""
    fault_state: int | None = None
    """A ``FaultState``."""
    verdict: int | None = None
    """A ``Verdict``."""


class Status(NamedTuple):
    """The content of the status frame, in codes."""

    fault_estimate: float
    mode: int
    fault_state: int
    verdict: int


def said(answer: Answer) -> Status:
    """The status of an answer, with a code for what the controller does not say.

    The node itself knows the mode: a tick without inputs never gets here without a mode.
    """
    _, _, estimate, mode, fault_state, verdict = answer
    if verdict is None:
        verdict = NO_DECISION if fault_state is None else NO_VERDICT
    return Status(
        math.nan if estimate is None else estimate,
        RUN if mode is None else mode,
        CANNOT_TELL if fault_state is None else fault_state,
        verdict,
    )


class Controller(Protocol):
    """A controller of one's own, constructed as ``Class(setup)`` with a ``ControllerSetup``.

    Without a reference or a measurement, the node holds the last commands and calls ``hold``, an
    optional method without arguments.
    """

    def reset(self, reference: float) -> None:
        """Begin in the steady state that holds the output at ``reference``."""

    def step(self, inputs: Inputs) -> Answer | tuple[float, float]:
        """The answer of a tick, or both commands alone."""


class NodeController(Protocol):
    """A controller as a node holds it; inputs that are not numbers have not come."""

    def reset(self, reference: float) -> None:
        """See ``Controller``."""

    def step(self, inputs: Inputs) -> Answer:
        """The answer of a tick."""

    @property
    def commands(self) -> tuple[float, float]:
        """The last commands, computed, held or settled."""

    def act(self, command_1: float, command_2: float) -> None:
        """The commands that act from the next ``step`` on, after a loss of the sent commands."""

    def take_over(self, inputs: Inputs, at_rest: bool) -> None:
        """Begin while the plant moves.

        Args:
            inputs: the last heard.
            at_rest: whether the actuators have let go of earlier commands.
        """

    def saved(self) -> bytes:
        """What outlives a restart; empty: nothing."""

    def restore(self, saved: bytes) -> bool:
        """Begin with ``saved`` after power-up; returns whether ``saved`` could be used."""


@dataclass(frozen=True)
class InNode:
    """A controller that a node of the rig steps: receive rules and frames are the node's.

    Attributes:
        start: a controller after power-up, ready for the first tick.
        without_frames: whether the loop without frames has the same controller.
    """

    start: Callable[[Scenario, Network], NodeController]
    without_frames: bool = False


COUNTS: Final = len(CheckStatus)

Sent = list[tuple[int, bytes]]
"""Identifier and data of each frame, in sending order."""


class Ecu(Protocol):
    """A controller node as a program."""

    def take(self, frame_id: int, data: bytes) -> Sent:
        """Deliver a frame; returns the sent frames: none unless the frame completes a tick.

        Identifiers have the flags of ``flagged``.

        Raises:
            ExportError: the node has ended.
        """

    def restart(self, state_survives: bool = False) -> object:
        """Begin as after power-up, with the state saved at the last tick or from nothing."""

    def counts(self) -> list[int]:
        """Frames by ``CheckStatus`` since the start: for reference, feedback, any speed."""

    def close(self) -> None:
        """Stop the node."""


@dataclass(frozen=True)
class WholeNode:
    """A whole controller node as a program."""

    start: Callable[[], Ecu]


Supplied = InNode | WholeNode
"""A controller, as a run is given it."""


def rejected(counts: list[int]) -> dict[str, int]:
    """Rejected frames by reason, of one receiver's ``counts``; reasons without frames left out."""
    named = zip(CheckStatus, counts, strict=True)
    return {status.name.lower(): n for status, n in named if n and status not in USABLE}
