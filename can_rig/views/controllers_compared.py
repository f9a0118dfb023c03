"""Several controllers through the same cases: a row of figures for each run, and one picture.

A case is a name and changes of the scenario: faults, weather, or cars that are not the model. A run
has no frames, and the same signals as a run on a bus.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from can_rig.drawing.thinning import thinned
from can_rig.errors import RigError, ScenarioError, in_python
from can_rig.logs.columns import TRUE_OUTPUT
from can_rig.results.counterfactual import signals_without_log
from can_rig.results.metrics import decision_metrics
from can_rig.results.signals import Signals
from can_rig.scenario import loading
from can_rig.scenario.controller_settings import PEERS
from can_rig.scenario.from_python import settings_of
from can_rig.scenario.loading import Changes, value_in, written
from can_rig.scenario.plant_settings import flat
from can_rig.scenario.settings import Scenario
from can_rig.storage.files import atomic, refuse_picture
from firmware_model.law.structs import FloatArray

if TYPE_CHECKING:
    import pandas as pd

SETTLED_S: Final = 2.0
NO_FAULT: Final = {"fault": [{"kind": "none"}]}
"""A list replaces the faults of the scenario; keys of one fault would keep its other keys."""


def _fault(kind: str, channel: str = "torque", **numbers: float) -> dict[str, Any]:
    return {"fault": [{"kind": kind, "channel": channel, "at_s": 10.0, **numbers}]}


def _weather(kind: str, **numbers: float) -> dict[str, Any]:
    return NO_FAULT | {"disturbance": [{"kind": kind, "at_s": 10.0, **numbers}]}


CASES: Final[Mapping[str, Mapping[str, Changes]]] = {
    "faults": {
        "healthy": NO_FAULT,
        "torque lost": _fault("actuator-dead"),
        "torque half lost": _fault("actuator-dead", left=0.5),
        "torque offset": _fault("actuator-offset", offset=20.0),
        "torque stuck": _fault("actuator-stuck"),
        "force difference lost": _fault("actuator-dead", "force-difference"),
        "sensor biased": _fault("sensor-biased", "sensor", bias_mps2=0.2),
        "torque frames lost for 0.1 s": _fault("frames-missing", for_s=0.1),
    },
    "weather": {
        "gust": _weather("gust", force_n=800.0, for_s=3.0),
        "bank": _weather("bank", bank_percent=4.0),
        "wet road": _weather("friction", front=0.6, rear=0.6),
        "torque lost in a gust": _weather("gust", force_n=800.0, for_s=3.0)
        | _fault("actuator-dead"),
    },
    "cars": {
        name: {f"plant.{key}*": factor, f"model.{key}*": 1.0} | _fault("actuator-dead")
        for name, key, factor in (
            ("heavy, torque lost", "mass_kg", 1.2),
            ("soft front tires, torque lost", "front_cornering_stiffness_n_per_rad", 0.8),
            ("faster, torque lost", "speed_mps", 1.2),
        )
    },
}
"""The shipped cases by group; ``KEY*`` is a factor of the number that the scenario has."""


@dataclass(frozen=True)
class Compared:
    """One run: the figures from the fault or the disturbance on, otherwise after 2 s.

    A run that ends before then counts from its middle on.

    Attributes:
        controller: its kind.
        error_peak_mps2: of |r - y|, y without the sensor's errors.
        error_rms_mps2: likewise.
        error_settled_mps2: the peak of the last 2 s.
        confirmed_after_s: ``detection_delay_s`` of a run; None: no loss is found, or not said.
        false_alarm: whether a loss of the torque was confirmed without one; None: not said.
        torque_peak_nm: of the whole run.
        force_difference_peak_n: likewise.
        failure: a line where the run failed; the figures are then not numbers.
        never: a line where a fault or a disturbance of the case begins after the end of the run.
    """

    controller: str
    case: str
    error_peak_mps2: float = math.nan
    error_rms_mps2: float = math.nan
    error_settled_mps2: float = math.nan
    confirmed_after_s: float | None = None
    false_alarm: bool | None = None
    torque_peak_nm: float = math.nan
    force_difference_peak_n: float = math.nan
    failure: str = ""
    never: str = ""


@dataclass(frozen=True)
class Comparison:
    """Every controller in every case.

    Attributes:
        rows: by case, then by controller.
        errors: (time, r - y) of each run, by controller and case, thinned for a picture.
    """

    rows: list[Compared]
    errors: dict[tuple[str, str], tuple[FloatArray, FloatArray]]

    @property
    def controllers(self) -> list[str]:
        """In their order."""
        return list(dict.fromkeys(row.controller for row in self.rows))

    @property
    def cases(self) -> list[str]:
        """In their order."""
        return list(dict.fromkeys(row.case for row in self.rows))

    @property
    def table(self) -> pd.DataFrame:
        """A row for each run."""
        import pandas as pd  # noqa: PLC0415 (half a second)

        return pd.DataFrame([asdict(row) for row in self.rows])

    @in_python
    def draw(self, path: str | Path, *, force: bool = False) -> None:
        """One picture: a panel for each case, a curve of the error for each controller.

        Args:
            path: where, by ``.png``, ``.svg`` or ``.pdf``.
            force: replace an existing file.

        Raises:
            LogError: another suffix, or the file exists or cannot be written.
        """
        from can_rig.drawing.style import BLUE, GREEN, INK, ORANGE, page, plain, ruled  # noqa: PLC0415

        colours = (BLUE, ORANGE, GREEN, INK, "#7a4b9e", "#9a8a1f")
        columns = min(3, len(self.cases))
        lines = -(-len(self.cases) // columns)
        figure = page(0.6 + 2.2 * lines, 4.2 * columns)
        panels = figure.subplots(lines, columns, squeeze=False, sharex=True).ravel()
        for panel, case in zip(panels, self.cases, strict=False):
            ruled(panel)
            panel.set_title(plain(case), fontsize=9, loc="left")
            panel.set_yscale("symlog", linthresh=0.01)
            for at, controller in enumerate(self.controllers):
                if (controller, case) in self.errors:
                    panel.plot(
                        *self.errors[controller, case], lw=1.0, label=plain(controller),
                        color=colours[at % len(colours)], ls="-" if at < len(colours) else "--",
                    )  # fmt: skip
        for panel in panels[len(self.cases) :]:
            panel.set_axis_off()
        panels[0].set_ylabel("r - y")
        panels[(lines - 1) * columns].set_xlabel("time in s")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False)
        path = Path(path)
        refuse_picture(path, force)
        with atomic(path, force=force) as part:
            figure.savefig(part, dpi=110)


def compare(
    controllers: Sequence[str],
    load: Callable[[Sequence[str]], Scenario],
    cases: Mapping[str, Changes],
    on_run: Callable[[int, int], None] = lambda done, of: None,
) -> Comparison:
    """Each controller, a ``controller.kind``, through each case of the scenario.

    A failing run is a row with the line of its failure.

    Args:
        controllers: kinds; a scenario file of one's own may stand for a kind with its settings.
        load: the scenario with ``KEY=VALUE`` changes.
        cases: changes by name.
        on_run: told how many runs are done, and of how many.

    Raises:
        ScenarioError: a scenario or a case that does not load.
    """
    if not (controllers and cases):
        raise ScenarioError("compare: must have a controller and a case at least")
    rows: list[Compared] = []
    errors: dict[tuple[str, str], tuple[FloatArray, FloatArray]] = {}
    for case, changes in cases.items():
        for controller in controllers:
            run = _scenario(load, controller, changes)
            try:
                signals = signals_without_log(run)
            except RigError as error:
                rows.append(Compared(controller, case, failure=str(error)))
            else:
                rows.append(_figures(controller, case, run, signals))
                errors[controller, case] = thinned(signals.time_s, _error(signals))
            on_run(len(rows), len(cases) * len(controllers))
    return Comparison(rows, errors)


def _scenario(
    load: Callable[[Sequence[str]], Scenario], controller: str, changes: Changes
) -> Scenario:
    """The scenario of a run; ``KEY*`` is a factor of the number that the scenario has."""
    base = load(()).as_dict()
    own: dict[str, Any] = {}
    for key, value in flat(changes):
        name = key.removesuffix("*")
        number = value_in(base, name)
        if name == key:
            own[key] = value
        elif all(isinstance(each, Real) for each in (value, number)):
            own[name] = value * number
        else:
            raise ScenarioError(
                f"{key} = {value!r}: must be a factor of a number; {name} is {number!r}"
            )
    if controller.endswith(".toml"):
        if not written(controller).values.get("controller"):
            raise ScenarioError(f"{controller}: must have a table [controller]; no other counts")
        kind = loading.load(controller, ()).controller
        return replace(load(settings_of(own)), controller=kind)
    own["controller.kind"] = controller
    return load(settings_of(own))


def _error(signals: Signals) -> FloatArray:
    return np.asarray(signals.reference_mps2 - signals.plant[TRUE_OUTPUT])


def _figures(controller: str, case: str, scenario: Scenario, signals: Signals) -> Compared:
    begin_s = min((each.at_s for each in scenario.spells), default=SETTLED_S)
    if begin_s >= signals.time_s[-1]:
        begin_s = 0.5 * signals.time_s[-1]
    after = signals.time_s >= begin_s
    size = np.abs(_error(signals))
    if not np.isfinite(size[after]).all():
        return Compared(controller, case, failure="the output is not a number: the loop diverges")
    decided = decision_metrics(scenario, signals)
    delay_s, alarms = decided["detection_delay_s"], decided["false_alarms"]
    settled = size[signals.time_s >= signals.time_s[-1] - SETTLED_S]
    return Compared(
        controller,
        case,
        error_peak_mps2=float(size[after].max()),
        error_rms_mps2=float(np.sqrt(np.mean(size[after] ** 2))),
        error_settled_mps2=float(settled.max()),
        confirmed_after_s=delay_s,
        false_alarm=None if alarms is None else alarms > 0,
        torque_peak_nm=float(np.nanmax(np.abs(signals.torque_nm))),
        force_difference_peak_n=float(np.nanmax(np.abs(signals.force_difference_n))),
        never="; ".join(scenario.never),
    )


def known_controllers() -> Iterator[str]:
    """The names that need no file."""
    yield "ours"
    yield from PEERS
