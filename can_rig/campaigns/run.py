"""One run of a campaign as a row: what it was, what came of it, and the command that repeats it."""

from __future__ import annotations

from typing import Any

from can_rig.campaigns.plan import Plan
from can_rig.campaigns.requirements import Requirement, margin
from can_rig.campaigns.table import METRICS
from can_rig.errors import RigError, one_line
from can_rig.results.without_log import metrics_of

Row = dict[str, Any]


def run_rows(plan: Plan, begin: int, end: int) -> list[Row]:
    """The rows of the runs from ``begin`` to ``end``."""
    required = requirements_of(plan)
    return [run_row(plan, required, run) for run in range(begin, end)]


def requirements_of(plan: Plan) -> list[Requirement]:
    """The campaign's requirements.

    Raises:
        ScenarioError: one is no expression over metrics.
    """
    return [Requirement(name, text, METRICS) for name, text in plan.settings.requirements.items()]


def run_row(plan: Plan, required: list[Requirement], run: int) -> Row:
    """The row of one run; one that fails has its reason in ``failure``, and no metrics."""
    row: Row = {"run": run, **plan.values_of(run), "command": plan.command_of(run)}
    try:
        scenario = plan.scenario_of(run)
        row["seed"] = scenario.seed
        row["simulated_s"] = scenario.ticks * scenario.tick_s
        values = metrics_of(scenario)
    except RigError as error:
        return {**row, "failure": one_line(error)}
    except (
        ArithmeticError,
        ValueError,
        LookupError,
        TypeError,
    ) as error:  # a defect
        return {**row, "failure": f"{type(error).__name__}: {one_line(error)}"}
    verdicts = {each.name: each.of(values) for each in required}
    passed = {f"passed.{name}": verdict.passed for name, verdict in verdicts.items()}
    return {**row, **values, **passed, "margin": margin(list(verdicts.values()))}
