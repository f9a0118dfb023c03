"""A controller of one's own in a node: guarded, limited, and held where inputs are missing."""

import math
from collections.abc import Callable
from numbers import Integral
from types import MappingProxyType
from typing import Any, Final

from can_rig.controllers.protocol import Answer, Inputs
from can_rig.controllers.setup import ControllerSetup
from can_rig.errors import RigError, ScenarioError
from can_rig.frames.codec import nothing_heard
from can_rig.scenario.own_class import as_float, failure, find_class, guard, require_signature
from firmware_model.law.status import Mode

METHODS: Final = {
    "reset": "reset(reference)",
    "step": "step(inputs) -> (command_1, command_2) or Answer",
}
BLIND: Final = int(Mode.BLIND)
CODES: Final = {"mode": 3, "fault_state": 3, "verdict": 13}
"""The largest code of each part of an answer."""
SAID: Final = 100
"""Characters of a refused answer in its line."""


def class_of(setup: ControllerSetup) -> Callable[[], Any]:
    """Constructs the class of ``controller.kind``.

    Raises:
        ScenarioError: no such class, or a class without the methods of a controller.
    """
    chosen = setup.scenario.controller
    where = where_of(setup)
    found = find_class(where, chosen.class_path, "step")
    name = found.__name__
    require_signature(where, found, name, f"{name}(setup)", setup)
    construct: Callable[..., Any] = found

    def made() -> Any:
        controller = guard(where, f"{name}(setup) failed", lambda: construct(setup))
        if setup.unread:
            raise ScenarioError(setup.unread)
        missing = [each for each in METHODS if not callable(getattr(controller, each, None))]
        if missing:
            raise ScenarioError(
                f"{where}: no method {' and no method '.join(missing)}; "
                f"must have {' and '.join(METHODS.values())}"
            )
        require_signature(where, controller.reset, "reset", METHODS["reset"], 0.0)
        require_signature(where, controller.step, "step", METHODS["step"], Inputs(0.0, 0.0))
        return controller

    return made


def where_of(setup: ControllerSetup) -> str:
    """Begins an error's line."""
    return f"controller.kind = {setup.scenario.controller.kind!r}"


class Peer:
    """A controller of one's own; see ``NodeController``.

    Raises:
        ScenarioError: the controller cannot be made, or fails at rest.
    """

    def __init__(self, setup: ControllerSetup, make: Callable[[], Any]) -> None:
        self._setup = setup
        self._where = where_of(setup)
        self.controller = make()
        self._limits, self._slews = setup.limits, setup.slews
        self._hold = getattr(self.controller, "hold", None)
        self._act = getattr(self.controller, "act", None)
        self._speed, self._ticks = math.nan, 0
        sensors = setup.scenario.sensors
        self._unheard = MappingProxyType(nothing_heard([each.usual.column for each in sensors]))
        self.commands = (0.0, 0.0)
        """See ``NodeController``."""
        guard(self._where, "reset(0) failed", lambda: self.controller.reset(0.0))

    def reset(self, reference: float) -> None:
        """See ``NodeController``."""
        guard(
            self._where,
            f"reset({reference:g}) failed",
            lambda: self.controller.reset(reference),
            RigError,
        )

    def step(self, inputs: Inputs) -> Answer:
        """See ``NodeController``.

        Raises:
            RigError: an exception of the controller, or an invalid answer.
        """
        self._ticks += 1
        if not inputs.witnesses:
            inputs = inputs._replace(witnesses=self._unheard)
        if math.isnan(inputs.speed_mps):
            inputs = inputs._replace(speed_mps=self._speed)
        self._speed = inputs.speed_mps
        if not (math.isfinite(inputs.reference) and math.isfinite(inputs.measurement)):
            if self._hold is not None:
                self._call("hold", self._hold)
            return Answer(*self.commands, mode=BLIND)
        answer = self._checked(self._call("step", self.controller.step, inputs))
        self.commands = self._possible(answer)
        command_1, command_2 = self.commands
        return answer._replace(command_1=command_1, command_2=command_2)

    def act(self, command_1: float, command_2: float) -> None:
        """See ``NodeController``; a controller without ``act`` is not told."""
        self.commands = command_1, command_2
        if self._act is not None:
            self._call("act", self._act, command_1, command_2)

    def take_over(self, inputs: Inputs, at_rest: bool) -> None:
        """See ``NodeController``."""
        self._speed = inputs.speed_mps
        self.reset(inputs.measurement)

    def saved(self) -> bytes:
        """See ``NodeController``: a controller of one's own remembers nothing."""
        return b""

    def restore(self, saved: bytes) -> bool:
        """See ``NodeController``."""
        return not saved

    def _call(self, name: str, method: Callable[..., Any], *arguments: object) -> Any:
        try:
            return method(*arguments)
        except KeyboardInterrupt:
            raise
        except RigError as error:
            raise RigError(f"{self._where}: {name} at {self._time}: {error}") from None
        except BaseException as error:
            what = f"{name} failed at {self._time}"
            raise RigError(failure(self._where, what, error)) from None

    @property
    def _time(self) -> str:
        return f"{(self._ticks - 1) * self._setup.tick_s:.9g} s"

    def _checked(self, answer: Any) -> Answer:
        """The answer of ``step``, with numbers of Python's."""
        try:
            command_1, command_2 = answer[:2] if isinstance(answer, Answer) else answer
        except (TypeError, ValueError):
            raise self._refused(answer, "must be (command_1, command_2) or an Answer") from None
        checked = answer if isinstance(answer, Answer) else Answer(command_1, command_2)
        numbers: dict[str, Any] = {}
        for name in ("command_1", "command_2", "fault_estimate"):
            value = getattr(checked, name)
            if value is None and name == "fault_estimate":
                continue
            numbers[name] = as_float(value)
            if not math.isfinite(numbers[name]):
                raise self._refused(answer, f"{name} must be a finite number")
        for name, largest in CODES.items():
            value = getattr(checked, name)
            if value is None:
                continue
            if not (isinstance(value, Integral) and 0 <= int(value) <= largest):
                raise self._refused(answer, f"{name} must be None or a code of 0 to {largest}")
            numbers[name] = int(value)
        return checked._replace(**numbers)

    def _refused(self, answer: object, right: str) -> RigError:
        try:
            said = " ".join(repr(answer).split())
        except Exception:  # a class without a sound __repr__
            said = f"a {type(answer).__name__}"
        said = said if len(said) <= SAID else f"{said[: SAID - 3]}..."
        return RigError(f"{self._where}: step at {self._time} answers {said}: {right}")

    def _possible(self, answer: Answer) -> tuple[float, float]:
        """The commands within the controller's limits, as the control law keeps them."""
        rows = zip(answer[:2], self.commands, self._limits, self._slews, strict=True)
        one, two = (
            min(max(wish, -limit, last - slew), limit, last + slew)
            for wish, last, limit, slew in rows
        )
        return one, two
