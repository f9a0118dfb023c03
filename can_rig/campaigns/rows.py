"""One run of a campaign as a row, and all rows as a table in Parquet, written in whole blocks."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from can_rig.campaigns.plan import Plan
from can_rig.campaigns.requirements import Requirement, least_of
from can_rig.campaigns.settings import SCENARIO, Scalar
from can_rig.drawing.names import unit_of
from can_rig.errors import RigError, ScenarioError, one_line
from can_rig.results.metrics import metrics, metrics_of
from can_rig.results.signals import Signals
from can_rig.scenario.settings import Scenario
from can_rig.storage.files import atomic

if TYPE_CHECKING:
    import pyarrow as pa

METRICS: Final = tuple(metrics(Scenario("none"), Signals(*np.empty((8, 0)))))
"""Names in the order of ``run.json``, of a run without a tick."""

TRUTHS: Final = {"missed_detection", "right_place", "wrong_place"}
"""Metrics with a truth value."""

TEXTS: Final = {"place", "verdict"}
"""Metrics that are words; no requirement has them."""

SEARCH, RANDOM = "search", "random"
"""How the values of a run came about, where some were searched."""

ROW_GROUP: Final = 16384
"""Rows that are held at once when blocks are put together."""


def schema(plan: Plan) -> pa.Schema:
    """Names and types of the columns; ``run`` is the number of the run."""
    import pyarrow as pa  # noqa: PLC0415 (slow to import)

    kinds = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}
    columns: dict[str, pa.DataType] = {"run": pa.int64(), SCENARIO: pa.string(), "seed": pa.int64()}
    for name in plan.settings.names:
        if name not in plan.settings.axes:
            columns[name] = pa.string()
    for key, axes in plan.settings.keys.items():
        own = plan.base.value(key)
        some = [own, *(value for axis in axes for value in axis.values or [])]
        found = {type(value) for value in some if value is not None} or {float}
        if own is None and any(axis.values is None for axis in axes):
            found = {float}
        kind = found.pop() if len(found) == 1 else float if found == {int, float} else str
        columns[key] = kinds[kind]
    if plan.searched:
        columns["method"] = pa.string()
    columns["simulated_s"] = pa.float64()
    for name in METRICS:
        columns[name] = pa.string() if name in TEXTS else pa.float64()
        if name in TRUTHS:
            columns[name] = pa.bool_()
    for name in plan.settings.requirements:
        columns[f"passed.{name}"] = pa.bool_()
    for name in plan.settings.requirements:
        columns[f"margin.{name}"] = pa.float64()
    columns |= {"margin": pa.float64(), "failure": pa.string(), "command": pa.string()}
    fields = pa.schema(list(columns.items()))
    return fields.with_metadata(_for_pandas(fields))


def _for_pandas(columns: pa.Schema) -> dict[str, str]:
    """What ``pandas.read_parquet`` makes of it: ``attrs["units"]``, and booleans with unknowns."""
    import pyarrow as pa  # noqa: PLC0415 (slow to import)

    truths = [
        {"name": field.name, "field_name": field.name, "pandas_type": "bool",
         "numpy_type": "boolean", "metadata": None}
        for field in columns
        if pa.types.is_boolean(field.type)
    ]  # fmt: skip
    units = {name: unit_of(name) for name in columns.names if unit_of(name)}
    described = {"columns": truths, "index_columns": [], "column_indexes": []}
    return {"pandas": json.dumps(described), "PANDAS_ATTRS": json.dumps({"units": units})}


def write_block(path: Path, rows: Iterable[dict[str, Any]], columns: pa.Schema) -> None:
    """Write the rows of a block; ``path`` exists, complete, when this returns, and not before.

    Raises:
        LogError: writing fails.
    """
    import pyarrow as pa  # noqa: PLC0415 (slow to import)
    from pyarrow import parquet  # noqa: PLC0415

    texts = [field.name for field in columns if pa.types.is_string(field.type)]
    given = [
        row | {name: repr(row[name]) for name in texts if not isinstance(row.get(name), str | None)}
        for row in rows
    ]
    with atomic(path, force=True) as part:
        parquet.write_table(pa.Table.from_pylist(given, schema=columns), part.absolute())


def put_together(blocks: Sequence[Path], path: Path) -> None:
    """Join all blocks, in the order of their runs, into one file.

    Memory holds one row group at a time.

    Raises:
        LogError: writing fails.
    """
    import pyarrow as pa  # noqa: PLC0415 (slow to import)
    from pyarrow import parquet  # noqa: PLC0415

    columns = parquet.read_schema(blocks[0].absolute())
    with (
        atomic(path, force=True) as part,
        parquet.ParquetWriter(part.absolute(), columns) as writer,
    ):
        waiting: list[pa.Table] = []
        for block in blocks:
            waiting.append(parquet.read_table(block.absolute()))
            if sum(len(table) for table in waiting) >= ROW_GROUP:
                writer.write_table(pa.concat_tables(waiting))
                waiting = []
        if waiting:
            writer.write_table(pa.concat_tables(waiting))


def read_columns(path: Path, names: Sequence[str] | None = None) -> dict[str, list[Any]]:
    """Columns of a table by name; None: all."""
    from pyarrow import parquet  # noqa: PLC0415 (slow to import)

    table = parquet.read_table(path.absolute(), columns=None if names is None else list(names))
    return {str(name): table[name].to_pylist() for name in table.column_names}


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
    known = [name for name in METRICS if name not in TEXTS]
    return [Requirement(name, text, known) for name, text in plan.settings.requirements.items()]


def require_tables(plan: Plan) -> None:
    """Refuse a table of the report over something that no run has.

    Raises:
        ScenarioError: names the table's key.
    """
    settings = plan.settings
    known = {SCENARIO, *settings.names, *settings.keys, *METRICS}
    for name, table in settings.tables.items():
        for key, given in (("rows", table.rows), ("columns", table.columns)):
            if given is not None and given not in known:
                raise ScenarioError(
                    f"campaign {settings.name}: tables.{name}.{key} = {given!r}: must be a metric, "
                    f"or {' or '.join(settings.names)}"
                )
        for metric in table.metrics:
            if metric not in METRICS or metric in TEXTS | TRUTHS:
                raise ScenarioError(
                    f"campaign {settings.name}: tables.{name}.metrics: {metric!r}: must be a "
                    "metric that is a number"
                )


def run_row(plan: Plan, required: list[Requirement], run: int, values: dict[str, Scalar]) -> Row:
    """The row of one run; after a failure, the reason in ``failure`` and no metrics."""
    changes, base = plan.changes_of(run, values), plan.base_of(values)
    row: Row = {
        "run": run,
        SCENARIO: base.scenario.name,
        **values,
        "command": base.command_with(changes),
    }
    row["method"] = SEARCH if run < plan.searched else RANDOM
    try:
        scenario = base.scenario_with(changes)
        row["seed"] = scenario.seed
        found = metrics_of(scenario)
        row["simulated_s"] = scenario.ticks * scenario.tick_s
    except RigError as error:
        return {**row, "failure": one_line(error)}
    except (ArithmeticError, AssertionError, ValueError, LookupError, TypeError) as error:
        return {**row, "failure": f"{type(error).__name__}: {one_line(error)}"}  # a defect
    margins = {each.name: each.of(found) for each in required}
    row |= {**found, "margin": least_of(margins.values())}
    for name, margin in margins.items():
        row[f"margin.{name}"] = margin
        row[f"passed.{name}"] = None if margin is None else margin > 0.0
    return row
