"""The user's plant: the methods of a plant class, its import and its checks.

``plant.kind = "package.module:Class"`` names it. The search includes the current directory, so
``mycar.py`` beside a scenario defines a plant:

    class Lag:                                     # plant.kind = "mycar:Lag"
        def __init__(self, settings):              # can_rig.scenario.plant_settings.PlantSettings
            self.reset()

        def reset(self):
            self.dstar_mps2 = 0.0

        def advance(self, dt_s, torque_nm, force_difference_n):
            target_mps2 = 0.02 * torque_nm + 3e-4 * force_difference_n
            self.dstar_mps2 += (target_mps2 - self.dstar_mps2) * min(1.0, dt_s / 0.1)
            return self.dstar_mps2
"""

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Protocol, runtime_checkable

from can_rig.errors import RigError, ScenarioError, require
from can_rig.logs.columns import TAKEN
from can_rig.plant.disturbances import inputs_of
from can_rig.scenario.disturbance_settings import DisturbanceSettings
from can_rig.scenario.own_class import as_float, failure, find_class, guard, require_signature
from can_rig.scenario.plant_settings import PUSHED_BY, PlantSettings
from can_rig.scenario.sensor_settings import USUAL
from firmware_model.law.structs import FloatArray

METHODS = {
    "reset": "reset()",
    "advance": "advance(dt_s, torque_nm, force_difference_n, world=None) -> dstar_mps2",
}
TRIAL_S = 0.001
_OTHERS = {*TAKEN, *(each.column for each in USUAL.values())}


@runtime_checkable
class PlantProtocol(Protocol):
    """A car between two ticks, constructed as ``Class(settings)`` and then at rest.

    The plant knows neither bus nor clock nor fault: its commands arrive late, limited, rounded, and
    reduced by a weak actuator. The controller starts from rest, so D* at rest must be 0.
    """

    def reset(self) -> None:
        """Back to rest: straight ahead, D* = 0."""

    def advance(self, dt_s: float, torque_nm: float, force_difference_n: float) -> float:
        """D* [m/s²] ``dt_s`` seconds later, both commands held until then.

        ``torque_nm`` is the steering motor's torque T, ``force_difference_n`` the rear wheels'
        X_diff, both of (3.11), as the actuators apply them. Every call of a run passes the same
        ``dt_s``: the tick, or an equal part of the tick if actuators or sensor lag.
        """


class PlantInTheWorld(PlantProtocol, Protocol):
    """A plant that the world pushes; the fourth argument of ``advance`` is optional."""

    def advance(
        self,
        dt_s: float,
        torque_nm: float,
        force_difference_n: float,
        world: FloatArray | None = None,
    ) -> float:
        """See ``PlantProtocol``.

        ``world`` (2, 7) has side force [N], yaw moment [N m], bank [rad], torque on the column [N
        m], friction factors of the front and the rear axle, and speed [m/s]: now, and ``dt_s``
        seconds later, with straight lines between; a plant other than a car has the push in the
        place of the side force. A scenario without disturbances leaves it out.
        """


@runtime_checkable
class ReportingPlant(PlantProtocol, Protocol):
    """A plant that also reports the car's motion; ``signals`` is optional."""

    def signals(self) -> Mapping[str, float]:
        """Present values by names that end in a unit, for example ``yaw_rate_rad_per_s``.

        Every tick has the same names. They become columns of ``signals.csv``.
        """


def load_plant(kind: str, settings: PlantSettings) -> PlantProtocol:
    """Make a new plant of the class or the FMU ``kind``, at rest.

    For a class, a trial with a separate instance at rest first proves ``reset`` and ``advance``.

    Raises:
        ScenarioError: an unknown module, class or FMU, or a class that violates ``PlantProtocol``.
        MissingExtraError: an FMU without an installed FMPy.
    """
    if settings.is_fmu:
        require("fmpy", "fmu")
        from can_rig.plant.fmu import FmuPlant  # noqa: PLC0415 (FMPy takes a second)

        return FmuPlant(settings)
    plant_class = find_class(_where(kind), kind, "advance")
    _try(kind, _construct(kind, plant_class, settings))
    return _construct(kind, plant_class, settings)


def require_world(settings: PlantSettings, disturbances: Iterable[DisturbanceSettings]) -> None:
    """Refuse a plant of one's own that ``disturbances`` cannot push; see ``PlantInTheWorld``.

    Raises:
        ScenarioError: a class whose ``advance`` has no ``world``, an FMU without the inputs.
    """
    kind = settings.kind
    if settings.is_class:
        advance = getattr(find_class(_where(kind), kind, "advance"), "advance", None)
        if callable(advance) and "world" not in inspect.signature(advance).parameters:
            raise ScenarioError(
                f"disturbance: plant.kind = {kind!r}: advance must have a fourth argument world; "
                "nothing pushes this plant"
            )
    if not settings.is_fmu:
        return
    for each in disturbances:
        for column in each.columns:
            if column not in settings.variables:
                raise ScenarioError(
                    f"disturbance.kind = {each.kind!r}: plant.variables.{column} must be set, as "
                    "the name of the FMU's input"
                )


def is_pushable(settings: PlantSettings) -> bool:
    """Whether the world can push the plant at all."""
    key = PUSHED_BY.get(settings.kind)
    if settings.is_fmu:
        return bool(inputs_of(settings))
    if settings.is_class:
        try:
            require_world(settings, ())
        except ScenarioError:
            return False
    return key is None or bool(getattr(settings, key))


class GuardedPlant:
    """A plant that reports exceptions of a run in one line, with the time.

    Args:
        kind: the plant's name.
        plant: from ``load_plant``.
    """

    def __init__(self, kind: str, plant: PlantProtocol) -> None:
        self._kind = kind
        self._plant = plant
        self._time_s = 0.0
        self._names: set[str] = set()

    def reset(self) -> None:
        """Back to rest; see ``PlantProtocol``.

        Raises:
            RigError: an exception in the class.
        """
        self._time_s = 0.0
        guard(_where(self._kind), "reset() failed", self._plant.reset, RigError)

    def advance(
        self, dt_s: float, torque_nm: float, force_difference_n: float, *world: FloatArray
    ) -> float:
        """D* ``dt_s`` seconds later; see ``PlantProtocol`` and ``PlantInTheWorld``.

        Raises:
            RigError: an exception in the class, or an answer other than a finite number.
        """
        try:
            answer = self._plant.advance(dt_s, torque_nm, force_difference_n, *world)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            what = f"advance failed at {self._time_s:.9g} s"
            raise RigError(failure(_where(self._kind), what, error)) from None
        if not math.isfinite(number := as_float(answer)):
            when = f"advance at {self._time_s:.9g} s"
            raise RigError(f"plant.kind = {self._kind!r}: {when} {_not_finite(answer)}")
        self._time_s += dt_s
        return number

    def readable(self) -> dict[str, float]:
        """What further sensors can read: ``signals``, and a car's ``witnesses`` without a column.

        Raises:
            RigError: as ``signals``.
        """
        hidden = getattr(self._plant, "witnesses", None)
        return {**(hidden() if callable(hidden) else {}), **self.signals()}

    def signals(self) -> dict[str, float]:
        """What the plant reports besides D*; see ``ReportingPlant``.

        Raises:
            RigError: an exception in the class, an invalid name or value.
        """
        plant = self._plant
        if not isinstance(plant, ReportingPlant):
            return {}
        what = f"signals() at {self._time_s:.9g} s"
        values = guard(_where(self._kind), f"{what} failed", plant.signals, RigError)
        reported = _reported(self._kind, what, values)
        self._names = self._names or set(reported)
        if reported.keys() != self._names:
            raise RigError(
                f"plant.kind = {self._kind!r}: {what} names {', '.join(reported) or 'nothing'}: "
                f"must be {', '.join(sorted(self._names))}, as before"
            )
        return reported


def _construct(kind: str, plant_class: type[object], settings: PlantSettings) -> PlantProtocol:
    """Make an instance with all methods; their behaviour is still untested."""
    _accepts(kind, plant_class, plant_class.__name__, settings)
    construct: Callable[..., object] = plant_class
    plant = guard(
        _where(kind), f"{plant_class.__name__}(settings) failed", lambda: construct(settings)
    )
    missing = [name for name in METHODS if not callable(getattr(plant, name, None))]
    if missing or not isinstance(plant, PlantProtocol):
        raise ScenarioError(
            f"plant.kind = {kind!r}: no method {' and no method '.join(missing)}; "
            f"must have {' and '.join(METHODS.values())}"
        )
    return plant


def _try(kind: str, plant: PlantProtocol) -> None:
    """Reset and advance at rest, without a command; discard ``plant`` afterwards."""
    _accepts(kind, plant.reset, "reset")
    _accepts(kind, plant.advance, "advance", TRIAL_S, 0.0, 0.0)
    guard(_where(kind), "reset() failed", plant.reset)
    trial = f"advance({TRIAL_S:g}, 0, 0) at rest"
    answer = guard(_where(kind), f"{trial} failed", lambda: plant.advance(TRIAL_S, 0.0, 0.0))
    if not math.isfinite(as_float(answer)):
        raise ScenarioError(f"plant.kind = {kind!r}: {trial} {_not_finite(answer)}")


def _reported(kind: str, what: str, values: object) -> dict[str, float]:
    """The signals of a plant, checked."""
    if not isinstance(values, Mapping):
        raise RigError(f"plant.kind = {kind!r}: {what} gives {values!r}: must be a dict")
    for name, value in values.items():
        if not (isinstance(name, str) and name.isidentifier() and name not in _OTHERS):
            raise RigError(
                f"plant.kind = {kind!r}: {what} names {name!r}: must be a name that no other "
                "column has, of letters, digits and _, and end in its unit"
            )
        if math.isnan(as_float(value)) and not (isinstance(value, float) and math.isnan(value)):
            raise RigError(
                f"plant.kind = {kind!r}: {what} gives {name} = {value!r}: must be a number"
            )
    return {name: as_float(value) for name, value in values.items()}


def _not_finite(answer: object) -> str:
    return f"gives {' '.join(repr(answer).split())}: D* must be a finite float"


def _where(kind: str) -> str:
    return f"plant.kind = {kind!r}"


def _accepts(kind: str, function: Callable[..., object], name: str, *arguments: object) -> None:
    right = METHODS.get(name, f"{name}(settings)")
    require_signature(_where(kind), function, name, right, *arguments)
