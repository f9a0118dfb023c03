"""The keys of a campaign's TOML file.

scenario = "default"
sampling = "latin-hypercube"
runs = 2000

[settings]                                  # of the scenario, in every run
duration_s = 14.0

[axes]                                      # what differs from run to run
"fault.at_s" = { range = [2.0, 10.0] }
"plant.mass_kg" = { share = 0.2 }           # of the scenario's own value, either way

[requirements]                              # over the metrics of run.json
found = "not missed_detection and detection_delay_s <= 0.5"
"""

from __future__ import annotations

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

SHIPPED: Final = Path(__file__).parent / "shipped"
MOST_RUNS: Final = 10_000_000
ALL: Final = "all"
"""The name that stands for the least margin of all requirements."""

Sampling = Literal["grid", "random", "latin-hypercube", "sobol"]
Scalar = bool | int | float | str


@dataclass(frozen=True, config=STRICT)
class AxisSettings:
    """The values of a key: ``values``, or a ``range``, or a ``share`` of the scenario's own.

    ``points`` counts the grid points on a range, ends included; ``scale`` is the scale of the
    range.
    """

    values: list[Scalar] | None = None
    range: tuple[float, float] | None = None
    share: Annotated[float, Field(gt=0.0, le=10.0)] | None = None
    scale: Literal["linear", "log"] = "linear"
    points: Annotated[int, Field(ge=2, le=MOST_RUNS)] | None = None

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


@dataclass(frozen=True, config=STRICT)
class CampaignSettings:
    """The settings of a campaign. ``name`` comes from the file's name.

    ``seed`` and a run's number alone determine the random values of the run. Without ``redesign``,
    an axis over ``plant`` changes the car but not the controller's model of the car. ``search``
    names a requirement, or ``ALL``, whose margin is minimised in ``runs`` runs; as many random runs
    are added for comparison.
    """

    name: str
    description: str = ""
    scenario: str = "default"
    sampling: Sampling = "random"
    runs: Annotated[int, Field(ge=1, le=MOST_RUNS)] | None = None
    repeats: Annotated[int, Field(ge=1, le=MOST_RUNS)] = 1
    seed: NonNegativeInt = 0
    redesign: bool = False
    search: str | None = None
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)
    axes: dict[str, AxisSettings] = dataclasses.field(default_factory=dict)
    requirements: dict[str, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
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

    def _refuse_search(self, search: str) -> None:
        known = [*self.requirements, ALL]
        for holds, must in (
            (bool(self.requirements), "come with a requirement"),
            (search in known, f"be a requirement, {' or '.join(known)}"),
            (self.sampling == "random", 'come with sampling = "random"'),
            (bool(self.axes), "come with axes to search on"),
        ):
            if not holds:
                raise ValueError(f"search = {search!r}: must {must}")

    def as_dict(self) -> dict[str, Any]:
        """Every key and value."""
        return dataclasses.asdict(self)


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
    path, values = toml_file("campaign", name, shipped())
    scenario = values.get("scenario")
    if isinstance(scenario, str) and scenario.endswith(".toml"):
        values["scenario"] = str(path.parent / scenario)
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
    try:
        return _ADAPTER.validate_json(json.dumps({**values, "name": name}, default=str))
    except ValidationError as error:
        raise ScenarioError(f"campaign {name}: {refusal(error, CampaignSettings)}") from None
