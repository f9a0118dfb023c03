"""A running FMU of FMI 2 or 3, through FMPy.

The FMU is unpacked, loaded and put at rest, advanced from tick to tick with its inputs held by its
own solver or by CVODE, and removed together with its ``Instance``.
"""

import math
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, contextmanager, suppress
from multiprocessing.util import Finalize
from pathlib import Path
from tempfile import mkdtemp
from types import SimpleNamespace
from typing import Any, Final

import fmpy
from fmpy.simulation import (
    apply_start_values,
    settable_in_initialization_mode,
    settable_in_instantiated,
)
from fmpy.sundials import CVodeSolver

from can_rig.errors import one_line
from can_rig.fmu.file import Description, Variable, unpack

TOLERANCE: Final = 1e-10
"""Relative tolerance of CVODE; each state's nominal value scales the absolute tolerance."""
MOST_STEPS: Final = 10_000
"""Limit for CVODE between two events or ticks."""
MOST_EVENTS: Final = 1_000
"""Limit per tick; a model with more events chatters."""
CLOSE: Final = 1e-9
"""Share of a step; two moments within this share count as equal."""


class FmuError(Exception):
    """An FMU that violates FMI, or reports an error."""


class Instance:
    """An FMU at rest at 0 s, its inputs at rest, its parameters set.

    Each instance has a folder and a library, so two instances never share an FMU's static memory.

    Raises:
        FmuError: a failure while loading or starting the FMU.
    """

    def __init__(self, description: Description) -> None:
        self._said = _Said()
        self.description = description
        folder = mkdtemp(prefix="can-rig-fmu-")
        # multiprocessing's Finalize, because a forked node ends without running Python's atexit.
        Finalize(self, shutil.rmtree, (folder, True), exitpriority=0)
        # FMPy changes to a library's folder, and stays there after a failed load.
        with chdir(Path.cwd()), self.explained(hidden=f"{folder}{os.sep}"):
            unpack(description.path, Path(folder))
            self.fmu = fmpy.simulation.instantiate_fmu(
                folder,
                description.model,
                "CoSimulation" if description.co_simulation else "ModelExchange",
                logger=self._said.hear,
            )
            Finalize(self, _free, (self.fmu,), exitpriority=1)
            self._start()

    def _start(self) -> None:
        fmu, model, parameters = self.fmu, self.description.model, self.description.parameters
        if model.fmiVersion.startswith("2"):
            fmu.setupExperiment(startTime=0.0)
        left = apply_start_values(fmu, model, parameters, settable_in_instantiated)
        fmu.enterInitializationMode()
        apply_start_values(fmu, model, left, settable_in_initialization_mode)
        self.write_inputs(self.description.at_rest)
        fmu.exitInitializationMode()

    def write_inputs(self, values: Sequence[float]) -> None:
        """Set every input, in the order of the description; inside ``explained``."""
        for variable, value in zip(self.description.inputs, values, strict=True):
            getattr(self.fmu, f"set{variable.access}")([variable.reference], [value])

    def read(self, variable: Variable) -> float:
        """The present value; inside ``explained``."""
        return float(getattr(self.fmu, f"get{variable.access}")([variable.reference])[0])

    @contextmanager
    def explained(self, hidden: str = "") -> Iterator[None]:
        """Turn every failure in this context into an ``FmuError`` with the FMU's last message."""
        try:
            yield
        except Exception as error:
            reason = one_line(error).replace(hidden, "").rstrip(".")
            said = f"; the FMU says: {self._said.last}" if self._said.last else ""
            raise FmuError(f"{reason}{said}") from None


class _Said:
    """The last message of an FMU, apart from its ``Instance``: the callback must not keep that."""

    def __init__(self) -> None:
        self.last = ""

    def hear(self, *arguments: Any) -> None:
        """Callback of FMI 2 and 3; the last argument is the message."""
        message = arguments[-1]
        if isinstance(message, bytes):
            self.last = " ".join(message.decode(errors="replace").split())


def _free(fmu: Any) -> None:
    with suppress(Exception):  # the FMU has no further message
        fmu.freeInstance()


class CoSimulation:
    """The FMU integrates from one communication point to the next."""

    def __init__(self, instance: Instance) -> None:
        self._instance = instance
        self._time_s = 0.0
        self._own_step_s = instance.description.model.coSimulation.fixedInternalStepSize

    def step(self, dt_s: float, inputs: Sequence[float]) -> None:
        """Advance by ``dt_s`` seconds, with the inputs held; any exception is the FMU's."""
        own_s = None if self._own_step_s is None else float(self._own_step_s)
        if own_s is not None and (
            dt_s < own_s or abs(dt_s / own_s - round(dt_s / own_s)) > CLOSE * dt_s / own_s
        ):
            raise FmuError(
                f"a step of {dt_s:g} s must be a multiple of {own_s:g} s, the FMU's own fixed step"
            )
        self._instance.write_inputs(inputs)
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

    def step(self, dt_s: float, inputs: Sequence[float]) -> None:
        """See ``CoSimulation``."""
        end_s, tiny_s = self._time_s + dt_s, CLOSE * dt_s
        self._event(inputs)
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
                self._event(inputs)
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

    def _event(self, inputs: Sequence[float]) -> None:
        self._fmu.enterEventMode()
        self._instance.write_inputs(inputs)
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

    def f(self, *arguments: Any) -> int:
        """The derivatives; see ``CVodeSolver``."""
        return self._kept(super().f, *arguments)

    def g(self, *arguments: Any) -> int:
        """The event indicators; see ``CVodeSolver``."""
        return self._kept(super().g, *arguments)

    def _kept(self, function: Callable[..., Any], *arguments: Any) -> int:
        try:
            return int(function(*arguments))
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


def stepping(instance: Instance) -> CoSimulation | ModelExchange:
    """The way of ``instance`` to advance; inside ``explained``."""
    if instance.description.co_simulation:
        return CoSimulation(instance)
    return ModelExchange(instance)
