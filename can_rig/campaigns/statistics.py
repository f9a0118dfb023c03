"""Statistics of a campaign: pass rates, worst runs, and the influence of the axes."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, chi2

from can_rig.campaigns.plan import Plan
from can_rig.campaigns.requirements import Requirement
from can_rig.campaigns.rows import RANDOM, SEARCH, TRUTHS
from can_rig.campaigns.settings import ALL, CampaignSettings
from firmware_model.law.structs import FloatArray

CONFIDENCE: Final = 0.95
BINS: Final = 8
"""Into which a continuous axis is cut, each with as many runs."""
WORST: Final = 10
NO_VALUE: Final = "-"
HOUR_S: Final = 3600.0
ALWAYS_SHOWN: Final = ("detection_delay_s", "deviation_peak_after_fault_mps2")

Columns = dict[str, list[Any]]


@dataclass(frozen=True)
class Rate:
    """Share of runs that pass, among runs with a verdict.

    Attributes:
        name: of the requirement. text: its expression.
        passed, failed, unknown: numbers of runs.
        share: ``passed`` among ``passed`` and ``failed``; None without any.
        low, high: the exact (Clopper-Pearson) interval of ``CONFIDENCE``; a grid's runs are not
            random, so its interval tells the precision of as many random runs.
    """

    name: str
    text: str
    passed: int
    failed: int
    unknown: int
    share: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Spread:
    """Distribution of a metric over the runs with a value."""

    name: str
    runs: int
    least: float
    median: float
    percentile_99: float
    greatest: float


@dataclass(frozen=True)
class Found:
    """Result of one sampling method for one requirement's margin.

    Attributes:
        method: search or random.
        runs: number of runs.
        least: the least margin; None without any margin.
        failed: number of runs with a margin below zero.
        first_failed: number of runs up to the first failure.
    """

    method: str
    runs: int
    least: float | None
    failed: int
    first_failed: int | None


@dataclass(frozen=True)
class Worst:
    """The run of a row that fails a requirement worst; ``values`` are the requirement's metrics."""

    run: int
    margin: float
    values: dict[str, float | bool | None]
    command: str


@dataclass(frozen=True)
class CrossRow:
    """The runs of one row of a table.

    Attributes:
        runs: number of runs; ``hours`` simulated, with so many ``false_alarms``.
        counts: number of runs by column.
        rates: for each requirement.
        spreads: for each metric of the table.
        worst: by requirement, the run that fails worst; none where no run fails.
    """

    name: str
    runs: int
    hours: float
    false_alarms: int
    counts: dict[str, int]
    rates: list[Rate]
    spreads: list[Spread]
    worst: dict[str, Worst]


@dataclass(frozen=True)
class Cross:
    """A table of the report: what its rows and columns are, and the runs of each row."""

    name: str
    of_rows: str
    of_columns: str | None
    columns: list[str]
    rows: list[CrossRow]


@dataclass(frozen=True)
class Summary:
    """A campaign in numbers.

    After a search, alarms, rates, spreads, sensitivities and tables cover the random runs only.

    Attributes:
        runs, failed: number of runs, and number of runs without metrics.
        reasons: reasons of failed runs, the most frequent first.
        hours: simulated.
        false_alarms: number, the hours without a loss of the torque in runs that count them, and
            the number per such hour with the exact (Poisson) interval of ``CONFIDENCE``.
        rates: for each requirement, and for all together.
        spreads: for each metric used by a requirement.
        worst: rows of the runs with the least margin, searched or not.
        sensitivities: for each metric, the share of variance explained by each axis alone.
        found: results of the search and of the random runs beside it; empty without a search.
        tables: the campaign's tables.
    """

    runs: int
    failed: int
    reasons: dict[str, int]
    hours: float
    false_alarms: dict[str, float | None]
    rates: list[Rate]
    spreads: list[Spread]
    worst: list[dict[str, Any]]
    sensitivities: dict[str, dict[str, float | None]]
    found: list[Found]
    tables: list[Cross]

    @property
    def passed(self) -> bool:
        """Whether every run has a result, and no run fails a requirement, searched or not."""
        return not (self.failed or any(run["margin"] < 0.0 for run in self.worst[:1]))


def summarise(plan: Plan, required: Sequence[Requirement], columns: Columns) -> Summary:
    """The summary of a table that ``table.read_columns`` has read."""
    everything = columns
    columns = {name: values[plan.searched :] for name, values in columns.items()}
    reasons = Counter(reason for reason in everything["failure"] if reason is not None)
    shown = metrics_shown(required)
    names = plan.settings.names
    hours = sum(s or 0.0 for s in everything["simulated_s"]) / HOUR_S
    alarms = round(sum(n or 0 for n in columns["false_alarms"]))
    pairs = zip(columns["torque_healthy_s"], columns["false_alarms"], strict=True)
    counted = sum(s or 0.0 for s, n in pairs if n is not None) / HOUR_S
    low, high = poisson_interval(alarms)
    per_hour = {
        "false_alarms": alarms,
        "hours": counted,
        "per_hour": alarms / counted if counted else None,
        "low": low / counted if counted else None,
        "high": high / counted if counted else None,
    }
    verdicts = {each.name: columns[f"passed.{each.name}"] for each in required}
    rates = [rate(each.name, each.text, verdicts[each.name]) for each in required]
    if len(required) > 1:
        rates.append(rate("all", "all of them", _together(list(verdicts.values()))))
    axes = {key: columns[key] for key in names}
    searched = everything[margin_column(plan)][: plan.searched]
    ways = (SEARCH, searched), (RANDOM, columns[margin_column(plan)])
    return Summary(
        runs=len(everything["run"]),
        failed=sum(reasons.values()),
        reasons=dict(reasons.most_common()),
        hours=hours,
        false_alarms=per_hour,
        rates=rates,
        spreads=[each for name in shown if (each := spread(name, columns[name])) is not None],
        worst=worst(everything, names),
        sensitivities={
            name: {key: explained(values, numbers(columns[name])) for key, values in axes.items()}
            for name in (*shown, "margin")
        },
        found=[found(how, some) for how, some in ways] if plan.searched else [],
        tables=[cross(name, plan.settings, required, columns) for name in plan.settings.tables],
    )


def cross(
    name: str, settings: CampaignSettings, required: Sequence[Requirement], columns: Columns
) -> Cross:
    """The table ``name`` of the report, from the columns of all runs."""
    table = settings.tables[name]
    of_run = parts_by_name(columns[table.rows])
    by_column = [] if table.columns is None else parts_by_name(columns[table.columns])
    rows = []
    for row in _in_order(settings, table.rows, columns, of_run):
        at = [run for run, its in enumerate(of_run) if its == row]
        some = {key: [values[run] for run in at] for key, values in columns.items()}
        counts = Counter(by_column[run] for run in at) if by_column else Counter()
        rows.append(CrossRow(
            name=row,
            runs=len(at),
            hours=sum(s or 0.0 for s in some["simulated_s"]) / HOUR_S,
            false_alarms=round(sum(n or 0 for n in some["false_alarms"])),
            counts=dict(counts),
            rates=[rate(each.name, each.text, some[f"passed.{each.name}"]) for each in required],
            spreads=[it for metric in table.metrics if (it := spread(metric, some[metric]))],
            worst={
                each.name: its for each in required if (its := _fails_worst(each, some)) is not None
            },
        ))  # fmt: skip
    listed = _in_order(settings, table.columns, columns, by_column) if table.columns else []
    return Cross(name, table.rows, table.columns, listed, rows)


def _fails_worst(required: Requirement, columns: Columns) -> Worst | None:
    margins = numbers(columns[f"margin.{required.name}"])
    if not (margins < 0.0).any():
        return None
    at = int(np.nanargmin(margins))
    values = {name: columns[name][at] for name in sorted(required.names)}
    return Worst(columns["run"][at], float(margins[at]), values, columns["command"][at])


def parts_by_name(values: Sequence[Any]) -> list[str]:
    """The name of the part of each value: a few values are one part each, many are cut."""
    known = [value for value in values if value is not None]
    if not known or isinstance(known[0], str | bool) or len(set(known)) <= BINS:
        return [NO_VALUE if value is None else f"{value}" for value in values]
    parts = parts_of(known)
    ends = {
        part: f"{min(its):.3g} to {max(its):.3g}"
        for part in set(parts.tolist())
        if (its := [value for value, of in zip(known, parts, strict=True) if of == part])
    }
    names = iter(ends[part] for part in parts.tolist())
    return [NO_VALUE if value is None else next(names) for value in values]


def _in_order(
    settings: CampaignSettings, key: str, columns: Columns, names: Sequence[str]
) -> list[str]:
    """The names in the order of the campaign's file, or of their values."""
    found = set(names)
    if key in settings.choices:
        return [name for name in settings.choices[key] if name in found]
    first: dict[str, Any] = {}
    for value, name in zip(columns[key], names, strict=True):
        if name not in first or (value is not None and value < first[name]):
            first[name] = value
    return sorted(first, key=lambda name: (name == NO_VALUE, first[name]))


def margin_column(plan: Plan) -> str:
    """The column that the search minimises."""
    return "margin" if plan.settings.search in (None, ALL) else f"margin.{plan.settings.search}"


def found(method: str, margins: Sequence[float | None]) -> Found:
    """The result for ``margins``, ordered by run."""
    values, so_far = numbers(margins), least_so_far(margins)
    failed = np.flatnonzero(values < 0.0)
    return Found(
        method=method,
        runs=len(values),
        least=None if np.isnan(so_far[-1]) else float(so_far[-1]),
        failed=len(failed),
        first_failed=int(failed[0]) + 1 if len(failed) else None,
    )


def least_so_far(margins: Sequence[float | None]) -> FloatArray:
    """The least margin up to each run; not a number before the first."""
    return np.fmin.accumulate(numbers(margins))


def metrics_shown(required: Sequence[Requirement]) -> list[str]:
    """The numbers that a report is about: those of the requirements, and ``ALWAYS_SHOWN``."""
    named = [name for each in required for name in sorted(each.names)]
    return [name for name in dict.fromkeys([*named, *ALWAYS_SHOWN]) if name not in TRUTHS]


def columns_needed(plan: Plan, required: Sequence[Requirement]) -> list[str]:
    """The columns of the table of runs that a summary reads."""
    names = [
        "run", "simulated_s", "failure", "false_alarms", "torque_healthy_s", "margin", "command",
        *plan.settings.names,
        *metrics_shown(required),
        *(name for each in required for name in sorted(each.names)),
        *(f"passed.{each.name}" for each in required),
        *(f"margin.{each.name}" for each in required),
    ]  # fmt: skip
    for table in plan.settings.tables.values():
        names += [name for name in (table.rows, table.columns, *table.metrics) if name is not None]
    return list(dict.fromkeys(names))


def rate(name: str, text: str, verdicts: Sequence[bool | None]) -> Rate:
    """How often ``verdicts`` are true."""
    passed, failed = (sum(each is wanted for each in verdicts) for wanted in (True, False))
    known = passed + failed
    if not known:
        return Rate(name, text, 0, 0, len(verdicts), None, None, None)
    interval = binomtest(passed, known).proportion_ci(CONFIDENCE, method="exact")
    return Rate(
        name, text, passed, failed, len(verdicts) - known,
        passed / known, float(interval.low), float(interval.high),
    )  # fmt: skip


def percent(share: float | None) -> str:
    """A share with two digits, or with six where two digits would say 0 % or 100 %."""
    if share is None:
        return NO_VALUE
    text = f"{share:.2%}"
    return f"{share:.6%}" if text in {"0.00%", "100.00%"} and 0.0 < share < 1.0 else text


def poisson_interval(events: int) -> tuple[float, float]:
    """The exact interval of the expected number where ``events`` were counted."""
    rest = (1.0 - CONFIDENCE) / 2.0
    low = float(chi2.ppf(rest, 2 * events)) / 2.0 if events else 0.0
    return low, float(chi2.ppf(1.0 - rest, 2 * events + 2)) / 2.0


def spread(name: str, values: Sequence[float | None]) -> Spread | None:
    """The distribution of a metric; None without a value."""
    found = numbers(values)
    found = found[np.isfinite(found)]
    if not len(found):
        return None
    least, median, high, greatest = np.percentile(found, [0, 50, 99, 100]).tolist()
    return Spread(name, len(found), least, median, high, greatest)


def worst(columns: Columns, axes: Sequence[str]) -> list[dict[str, Any]]:
    """The rows of least margin, the worst first; ties keep the order of the runs."""
    margins = numbers(columns["margin"])
    order = np.argsort(np.where(np.isnan(margins), np.inf, margins), kind="stable")[:WORST]
    shown = ["run", *axes, "margin", "command"]
    rows = [at for at in order.tolist() if not np.isnan(margins[at])]
    return [{name: columns[name][at] for name in shown} for at in rows]


def explained(axis: Sequence[Any], metric: FloatArray) -> float | None:
    """The share of the metric's variance between parts of the axis, η², less that of chance.

    None if the metric or the axis is constant.
    """
    known = np.isfinite(metric)
    parts, values = parts_of(axis)[known], metric[known]
    groups = np.unique(parts)
    n, k = len(values), len(groups)
    total = float(np.sum((values - values.mean()) ** 2)) if n else 0.0
    if k < 2 or n <= k or total <= 0.0:
        return None
    within = sum(len(some) * float(np.var(some)) for some in (values[parts == g] for g in groups))
    return max(0.0, 1.0 - (within / (n - k)) / (total / (n - 1)))  # adjusted: 0 for pure chance


def parts_of(axis: Sequence[Any]) -> NDArray[np.int64]:
    """The part of the axis for each run.

    A few values are one part each; many values are cut into quantiles.
    """
    distinct = sorted(set(axis), key=lambda value: (str(type(value)), value))
    if len(distinct) <= BINS or isinstance(distinct[0], str):
        return np.array([distinct.index(value) for value in axis], dtype=np.int64)
    values = np.array(axis, dtype=np.float64)
    edges = np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)[1:-1])
    return np.searchsorted(edges, values, side="right")


def numbers(values: Sequence[float | bool | None]) -> FloatArray:
    """As floats; nan for missing values."""
    return np.array([np.nan if value is None else float(value) for value in values])


def _together(verdicts: Sequence[Sequence[bool | None]]) -> list[bool | None]:
    """Whether all requirements hold, run by run: any false decides."""
    return [
        False if False in row else None if None in row else True
        for row in zip(*verdicts, strict=True)
    ]
