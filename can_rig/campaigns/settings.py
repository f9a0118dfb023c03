"""The keys of a campaign's TOML file.

scenario = "default"
sampling = "latin-hypercube"
runs = 2000

[settings]                                  # of the scenario, in every run
duration_s = 14.0

[axes]                                      # what differs from run to run
"fault.at_s" = { range = [2.0, 10.0] }
"plant.mass_kg" = { share = 0.2 }           # of the scenario's own value, either way

[choices."fault.0"]                         # one of several, with keys of that table
"torque lost" = { kind = "actuator-dead" }
"torque offset" = { kind = "actuator-offset", offset = { range = [10.0, 50.0] } }

[requirements]                              # over the metrics of run.json
found = "not missed_detection and detection_delay_s <= 0.5"

[tables.verdicts]                           # of the report
rows = "fault.0"
columns = "verdict"
"""

import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, NonNegativeInt, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from can_rig.errors import ScenarioError
from can_rig.scenario.loading import change, toml_file
from can_rig.scenario.plant_settings import STRICT
from can_rig.scenario.refusal import refusal
from can_rig.scenario.settings import LISTS

SHIPPED: Final = Path(__file__).parent / "shipped"
MOST_RUNS: Final = 10_000_000
SCENARIO: Final = "scenario"
"""The column that says which of several scenarios a run has."""
ALL: Final = "all"
"""The name that stands for the least margin of all requirements."""

Sampling = Literal["grid", "random", "latin-hypercube", "sobol"]
Scalar = bool | int | float | str


@dataclass(frozen=True, config=STRICT)
class AxisSettings:
    """The values of a key: ``values``, or a ``range``, or a ``share`` of the scenario's own.

    ``points`` counts the grid points on a range, ends included; ``scale`` is the scale of the
    range. With ``either_sign``, half of the values are negative. ``times``, ``per`` and ``plus``
    name keys of the same run: their values multiply, divide and shift the drawn value.
    """

    values: list[Scalar] | None = None
    range: tuple[float, float] | None = None
    share: Annotated[float, Field(gt=0.0, le=10.0)] | None = None
    scale: Literal["linear", "log"] = "linear"
    points: Annotated[int, Field(ge=2, le=MOST_RUNS)] | None = None
    either_sign: bool = False
    times: str | None = None
    per: str | None = None
    plus: str | None = None

    @property
    def is_drawn(self) -> bool:
        """Whether the value differs from run to run."""
        return self.values is None or len(self.values) > 1

    @property
    def others(self) -> list[str]:
        """The keys whose values change the drawn value."""
        return [key for key in (self.times, self.per, self.plus) if key is not None]

    def __post_init__(self) -> None:
        given = [name for name in ("values", "range", "share") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                f"values, range, share: {' and '.join(given) or 'none'} set; must be exactly one"
            )
        if self.values is not None and not self.values:
            raise ValueError("values = []: must have at least one value")
        if self.range is not None:
            low, high = self.range
            if not low < high:
                raise ValueError(f"range = [{low:g}, {high:g}]: must increase")
            if self.scale == "log" and low <= 0.0:
                raise ValueError(
                    f'range = [{low:g}, {high:g}]: scale = "log" needs numbers above 0'
                )
        texts = [value for value in self.values or () if isinstance(value, bool | str)]
        if texts and (self.either_sign or self.others):
            raise ValueError(
                f"values: {texts[0]!r}: must be a number beside either_sign, times, per and plus"
            )


Alternative = dict[str, AxisSettings]
"""Keys within a table of the scenario, and their values."""


@dataclass(frozen=True, config=STRICT)
class TableSettings:
    """A table of the report: a row for each value of ``rows``, a column for each of ``columns``.

    Both name the scenario, a choice, an axis or a metric; many numbers are cut into parts. A row
    also has the median, the 99 % and the greatest value of each of ``metrics``.
    """

    rows: str
    columns: str | None = None
    metrics: list[str] = dataclasses.field(default_factory=list)


@dataclass(frozen=True, config=STRICT)
class CampaignSettings:
    """The settings of a campaign. ``name`` comes from the file's name.

    ``seed`` and a run's number alone determine the random values of the run. Without ``redesign``,
    an axis over ``plant`` changes the car but not the controller's model of the car. A run draws
    one of several scenarios, and one alternative of each choice. ``search``
    names a requirement, or ``ALL``, whose margin is minimised in ``runs`` runs; as many random runs
    are added for comparison.
    """

    name: str
    description: str = ""
    scenario: list[str] = dataclasses.field(default_factory=lambda: ["default"])
    sampling: Sampling = "random"
    runs: Annotated[int, Field(ge=1, le=MOST_RUNS)] | None = None
    repeats: Annotated[int, Field(ge=1, le=MOST_RUNS)] = 1
    seed: NonNegativeInt = 0
    redesign: bool = False
    search: str | None = None
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)
    axes: dict[str, AxisSettings] = dataclasses.field(default_factory=dict)
    choices: dict[str, dict[str, Alternative]] = dataclasses.field(default_factory=dict)
    requirements: dict[str, str] = dataclasses.field(default_factory=dict)
    tables: dict[str, TableSettings] = dataclasses.field(default_factory=dict)

    @property
    def keys(self) -> dict[str, list[AxisSettings]]:
        """Every key of the scenario that differs from run to run, and what gives its value."""
        found = {key: [axis] for key, axis in self.axes.items()}
        for table, alternatives in self.choices.items():
            for alternative in alternatives.values():
                for key, axis in alternative.items():
                    found.setdefault(f"{table}.{key}", []).append(axis)
        return found

    @property
    def names(self) -> list[str]:
        """What a run is told apart by: its scenario among several, its choices, and its axes."""
        several = [SCENARIO] if len(self.scenario) > 1 else []
        return [*several, *self.choices, *self.axes]

    def __post_init__(self) -> None:
        if not self.scenario:
            raise ValueError("scenario = []: must have at least one scenario")
        if ALL in self.requirements:
            raise ValueError(f"requirements.{ALL}: must have another name: {ALL} means all of them")
        self._refuse_choices()
        if self.search is not None:
            self._refuse_search(self.search)
        if self.sampling == "grid":
            if self.runs is not None:
                raise ValueError(
                    f"runs = {self.runs}: must not be set for a grid, whose axes give the number; "
                    "repeats runs each point several times"
                )
            for key, axis in self.axes.items():
                if axis.values is None and axis.points is None:
                    raise ValueError(
                        f'axes.{key}: must have points or values for sampling = "grid"'
                    )
            return
        if self.runs is None:
            raise ValueError(f'runs: must be set where sampling = "{self.sampling}"')
        if self.repeats != 1:
            raise ValueError(f'repeats = {self.repeats}: must be 1 unless sampling = "grid"')
        for key, axis in self.axes.items():
            if axis.points is not None:
                raise ValueError(
                    f'axes.{key}.points = {axis.points}: must not be set unless sampling = "grid"'
                )

    def _refuse_choices(self) -> None:
        for table, alternatives in self.choices.items():
            if not alternatives:
                raise ValueError(f"choices.{table}: must have at least one alternative")
            for key in self.axes:
                if any(key == f"{table}.{own}" for each in alternatives.values() for own in each):
                    raise ValueError(f"axes.{key}: must not stand beside the same key of a choice")
            for name, alternative in alternatives.items():
                for key, axis in alternative.items():
                    where = f"choices.{table}.{name}.{key}"
                    if self.sampling == "grid" and axis.is_drawn:
                        raise ValueError(f'{where}: must be one value for sampling = "grid"')
                    if axis.points is not None:
                        raise ValueError(f"{where}.points: must not be set in a choice")
        self._refuse_numbers()
        self._refuse_dependence()

    def _refuse_numbers(self) -> None:
        """Refuse a fault with a number beside a fault without a number."""
        for name in LISTS:
            own = [key for key in self.keys if key.startswith(f"{name}.")]
            with_number = [key for key in own if key.split(".")[1].isdecimal()]
            without = [key for key in own if key not in with_number]
            if with_number and without:
                raise ValueError(f"{without[0]}: must have a number, as {with_number[0]} has")

    def _refuse_dependence(self) -> None:
        """Refuse chains: a key may depend on drawn values and settings only."""
        dependent = {key for key, axes in self.keys.items() if any(axis.others for axis in axes)}
        for key, axes in self.keys.items():
            for other in (other for axis in axes for other in axis.others):
                if other in dependent:
                    raise ValueError(
                        f"{key}: {other}: must be a key whose value depends on no other key"
                    )

    def _refuse_search(self, search: str) -> None:
        known = [*self.requirements, ALL]
        for holds, must in (
            (bool(self.requirements), "come with a requirement"),
            (search in known, f"be a requirement, {' or '.join(known)}"),
            (self.sampling == "random", 'come with sampling = "random"'),
            (bool(self.names), "come with axes to search on"),
        ):
            if not holds:
                raise ValueError(f"search = {search!r}: must {must}")


_ADAPTER: Final = TypeAdapter(CampaignSettings)


def shipped() -> dict[str, Path]:
    """Name → file of the campaigns that come with the package, sorted."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.toml"))}


def read_campaign(name: str, settings: Iterable[str] = (), **keys: Any) -> CampaignSettings:
    """The campaign ``name``, a shipped one or a path to a TOML file.

    Args:
        name: of the campaign.
        settings: ``KEY=VALUE`` settings of the scenario, for every run.
        keys: keys of the campaign that replace the file's; None: the file's.

    Raises:
        ScenarioError: no such campaign, not TOML, an unknown key, a bad value.
    """
    path, values = _extended(name)
    if "name" in values:
        raise ScenarioError(f"campaign {name}: name: unknown key; a campaign is named by its file")
    values |= {key: value for key, value in keys.items() if value is not None}
    if keys.get("search") is not None:
        _draw(values)
    common = values.setdefault("settings", {})
    for setting in settings:
        if not isinstance(common, dict):
            raise ScenarioError(f"campaign {name}: settings = {common!r}: must be a table")
        change(common, setting)
    return campaign_of(path.stem, values)


def _extended(name: str) -> tuple[Path, dict[str, Any]]:
    """The file of a campaign and its keys; ``extends`` names a campaign to begin from."""
    path, values = toml_file("campaign", name, shipped())
    scenarios = values.get(SCENARIO)
    if isinstance(scenarios, str | list):
        listed = [scenarios] if isinstance(scenarios, str) else scenarios
        values[SCENARIO] = [
            str(path.parent / each) if isinstance(each, str) and each.endswith(".toml") else each
            for each in listed
        ]
    given = values.pop("extends", None)
    if given is None:
        return path, values
    if not isinstance(given, str):
        raise ScenarioError(f"campaign {name}: extends = {given!r}: must be the name of a campaign")
    if given not in shipped():
        raise ScenarioError(
            f"campaign {name}: extends = {given!r}: must be a shipped campaign, "
            f"{' or '.join(shipped())}"
        )
    _, before = _extended(given)
    for key, value in values.items():
        own = before.get(key)
        before[key] = (
            {**own, **value} if isinstance(own, dict) and isinstance(value, dict) else value
        )
    return path, before


def _draw(values: dict[str, Any]) -> None:
    """A search draws its points, whatever the campaign would do without one."""
    values["sampling"] = "random"
    values.pop("repeats", None)
    axes = values.get("axes")
    for axis in axes.values() if isinstance(axes, dict) else ():
        if isinstance(axis, dict):
            axis.pop("points", None)


def campaign_of(name: str, values: dict[str, Any]) -> CampaignSettings:
    """A campaign from plain values.

    Raises:
        ScenarioError: an unknown key, a bad value.
    """
    values = {**values, "name": name}
    if isinstance(values.get(SCENARIO), str):
        values[SCENARIO] = [values[SCENARIO]]
    if isinstance(choices := values.get("choices"), dict):
        values["choices"] = {table: _alternatives(name, choices, table) for table in choices}
    try:
        return _ADAPTER.validate_json(json.dumps(values, default=str))
    except ValidationError as error:
        raise ScenarioError(f"campaign {name}: {refusal(error, CampaignSettings)}") from None


def _alternatives(name: str, choices: dict[str, Any], table: str) -> Any:
    """The alternatives of a choice, with a single value as a list of one."""
    given = choices[table]
    if isinstance(given, str):
        same = choices.get(given)
        if not isinstance(same, dict):
            raise ScenarioError(
                f"campaign {name}: choices.{table} = {given!r}: must be alternatives, or the name "
                "of another choice that has them"
            )
        given = same
    if not isinstance(given, dict):
        return given
    return {
        alternative: {
            key: value if isinstance(value, dict | list) else {"values": [value]}
            for key, value in keys.items()
        }
        if isinstance(keys, dict)
        else keys
        for alternative, keys in given.items()
    }
