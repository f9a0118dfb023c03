"""Steps from tick to tick with both inputs held, by the FMU's own solver or by CVODE."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, Final, Protocol

from fmpy.sundials import CVodeSolver

from can_rig.errors import one_line
from can_rig.plant.fmu.instance import FmuError, Instance

TOLERANCE: Final = 1e-10
"""Relative tolerance of CVODE; each state's nominal value scales the absolute tolerance."""
MOST_STEPS: Final = 10_000
"""Limit for CVODE between two events or ticks."""
MOST_EVENTS: Final = 1_000
"""Limit per tick; a model with more events chatters."""
CLOSE: Final = 1e-9
"""Share of a step; two moments within this share count as equal."""


class Stepping(Protocol):
    """Advances an FMU in time."""

    def step(self, dt_s: float, first: float, second: float) -> None:
        """Advance by ``dt_s`` seconds, with both inputs held.

        Raises:
            Exception: any failure of FMPy or the FMU; see ``Instance.explained``.
        """


def stepping(instance: Instance) -> Stepping:
    """Choose the stepping for the FMI type."""
    return CoSimulation(instance) if instance.description.co_simulation else ModelExchange(instance)


class CoSimulation:
    """The FMU integrates from one communication point to the next."""

    def __init__(self, instance: Instance) -> None:
        self._instance = instance
        self._time_s = 0.0
        self._own_step_s = instance.description.model.coSimulation.fixedInternalStepSize

    def step(self, dt_s: float, first: float, second: float) -> None:
        """See ``Stepping``."""
        own_s = None if self._own_step_s is None else float(self._own_step_s)
        if own_s is not None and (
            dt_s < own_s or abs(dt_s / own_s - round(dt_s / own_s)) > CLOSE * dt_s / own_s
        ):
            raise FmuError(
                f"a step of {dt_s:g} s must be a multiple of {own_s:g} s, the FMU's own fixed step"
            )
        self._instance.write_inputs(first, second)
        answer = self._instance.fmu.doStep(self._time_s, dt_s)
        if answer is not None:  # only FMI 3
            _, ends, early, reached_s = answer
            if ends:
                raise FmuError("the FMU ends the simulation")
            if early:
                raise FmuError(f"the FMU returned early, at {reached_s:g} s, unasked")
        self._time_s += dt_s


class ModelExchange:
    """CVODE integrates the FMU's derivatives from event to event.

    A tick begins with an event, because the inputs jump there.
    """

    def __init__(self, instance: Instance) -> None:
        self._instance = instance
        self._fmu = instance.fmu
        model = instance.description.model
        self._needs_completed_step = model.modelExchange.needsCompletedIntegratorStep
        self._is_fmi_2 = model.fmiVersion.startswith("2")
        self._time_s = 0.0
        self._next_event_s = math.inf
        self._update_discrete_states()  # an FMU leaves initialisation in event mode
        self._fmu.enterContinuousTimeMode()
        self._solver = _Solver(
            nx=model.numberOfContinuousStates,
            nz=model.numberOfEventIndicators,
            get_x=self._fmu.getContinuousStates,
            set_x=self._fmu.setContinuousStates,
            get_dx=getattr(
                self._fmu, "getDerivatives" if self._is_fmi_2 else "getContinuousStateDerivatives"
            ),
            get_z=self._fmu.getEventIndicators,
            get_nominals=self._fmu.getNominalsOfContinuousStates,
            set_time=self._fmu.setTime,
            input=SimpleNamespace(apply=lambda time_s: None),  # held inputs
            startTime=0.0,
            relativeTolerance=TOLERANCE,
            maxNumSteps=MOST_STEPS,
        )

    def step(self, dt_s: float, first: float, second: float) -> None:
        """See ``Stepping``."""
        end_s, tiny_s = self._time_s + dt_s, CLOSE * dt_s
        self._event(first, second)
        events = 0
        while self._time_s < end_s - tiny_s:
            if self._next_event_s <= self._time_s + tiny_s:
                happens = True
                self._time_s = max(self._time_s, self._next_event_s)
                self._fmu.setTime(self._time_s)
            else:
                happens = self._integrate(min(end_s, self._next_event_s))
            if happens:
                events += 1
                self._event(first, second)
            if events > MOST_EVENTS:
                raise FmuError(f"more than {MOST_EVENTS} events in one step")
        self._time_s = end_s

    def _integrate(self, until_s: float) -> bool:
        """Advance to ``until_s`` or an earlier state event; return whether an event occurred."""
        state_event, _, self._time_s = self._solver.step(self._time_s, until_s)
        self._fmu.setTime(self._time_s)
        step_event = ends = False
        if self._needs_completed_step:
            step_event, ends = self._fmu.completedIntegratorStep()
        if ends:
            raise FmuError("the FMU ends the simulation")
        return bool(state_event or step_event)

    def _event(self, first: float, second: float) -> None:
        self._fmu.enterEventMode()
        self._instance.write_inputs(first, second)
        self._update_discrete_states()
        self._fmu.enterContinuousTimeMode()
        self._solver.reset(self._time_s)

    def _update_discrete_states(self) -> None:
        update = self._fmu.newDiscreteStates if self._is_fmi_2 else self._fmu.updateDiscreteStates
        for _ in range(MOST_EVENTS):
            again, ends, _, _, is_next, next_s = update()
            if ends:
                raise FmuError("the FMU ends the simulation")
            if not again:
                self._next_event_s = next_s if is_next else math.inf
                return
        raise FmuError("the discrete states do not settle")


class _Solver(CVodeSolver):  # type: ignore[misc]  # FMPy has no types
    """CVODE with the FMU's failure kept; ctypes would print the failure and continue."""

    def __init__(self, **arguments: Any) -> None:
        self._failure = ""  # the text only: an exception's traceback would keep the FMU alive
        super().__init__(**arguments)

    def f(self, t: float, y: Any, ydot: Any, user_data: Any) -> int:
        """The derivatives; see ``CVodeSolver``."""
        try:
            return int(super().f(t, y, ydot, user_data))
        except Exception as error:
            self._failure = one_line(error)
            return -1

    def g(self, t: float, y: Any, gout: Any, user_data: Any) -> int:
        """The event indicators; see ``CVodeSolver``."""
        try:
            return int(super().g(t, y, gout, user_data))
        except Exception as error:
            self._failure = one_line(error)
            return -1

    def step(self, t: float, tNext: float) -> tuple[bool, Any, float]:
        """See ``CVodeSolver``."""
        try:
            event, roots, reached = super().step(t, tNext)
        except Exception:
            if not self._failure:
                raise
            raise FmuError(self._failure) from None
        return event, roots, reached
