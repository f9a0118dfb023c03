"""One run of a campaign as a row: its settings, its results, and the command to repeat the run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from can_rig.campaigns.plan import Plan
from can_rig.campaigns.requirements import Requirement, margin
from can_rig.campaigns.settings import Scalar
from can_rig.campaigns.table import METRICS, RANDOM, SEARCH
from can_rig.errors import RigError, one_line
from can_rig.results.metrics import metrics_of

Row = dict[str, Any]


class Task(NamedTuple):
    """Runs computed as a unit.

    Attributes:
        begin: the first. end: the run after the last run.
        points: of a search, the place of each in [0, 1] on every axis.
    """

    begin: int
    end: int
    points: tuple[tuple[float, ...], ...] | None = None

    def parts(self, most: int) -> Iterator[Task]:
        """Split the task into tasks of at most ``most`` runs."""
        for begin in range(self.begin, self.end, most):
            end = min(begin + most, self.end)
            points = self.points and self.points[begin - self.begin : end - self.begin]
            yield Task(begin, end, points)


def run_rows(plan: Plan, task: Task) -> list[Row]:
    """The rows of the runs of ``task``."""
    required = requirements_of(plan)
    numbers = range(task.begin, task.end)
    if task.points is None:
        return [run_row(plan, required, run, plan.values_of(run)) for run in numbers]
    return [
        run_row(plan, required, run, plan.values_at(point))
        for run, point in zip(numbers, task.points, strict=True)
    ]


def requirements_of(plan: Plan) -> list[Requirement]:
    """The campaign's requirements.

    Raises:
        ScenarioError: a requirement is no expression over metrics.
    """
    return [Requirement(name, text, METRICS) for name, text in plan.settings.requirements.items()]


def run_row(plan: Plan, required: list[Requirement], run: int, values: dict[str, Scalar]) -> Row:
    """The row of one run; after a failure, the reason in ``failure`` and no metrics."""
    changes = plan.changes_of(run, values)
    row: Row = {"run": run, **values, "command": plan.command_with(changes)}
    row["method"] = SEARCH if run < plan.searched else RANDOM
    try:
        scenario = plan.scenario_with(changes)
        row["seed"] = scenario.seed
        row["simulated_s"] = scenario.ticks * scenario.tick_s
        metrics = metrics_of(scenario)
    except RigError as error:
        return {**row, "failure": one_line(error)}
    except (
        ArithmeticError,
        AssertionError,
        ValueError,
        LookupError,
        TypeError,
    ) as error:  # a defect
        return {**row, "failure": f"{type(error).__name__}: {one_line(error)}"}
    verdicts = {each.name: each.of(metrics) for each in required}
    passed = {f"passed.{name}": verdict.passed for name, verdict in verdicts.items()}
    margins = {f"margin.{name}": verdict.margin for name, verdict in verdicts.items()}
    return {**row, **metrics, **passed, **margins, "margin": margin(list(verdicts.values()))}
