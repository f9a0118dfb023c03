"""``can-rig campaign``: thousands of runs, a table, a report."""

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict
from pathlib import Path
from types import FrameType
from typing import Final

import click
from rich.table import Table

from can_rig.campaigns.execution import CampaignFolder, execute, open_folder
from can_rig.campaigns.plan import Plan, plan
from can_rig.campaigns.report import write_report
from can_rig.campaigns.settings import read_campaign
from can_rig.campaigns.statistics import Cross, Summary, percent
from can_rig.campaigns.workers import Compute, in_processes, serially
from can_rig.cli.options import json_option, set_option
from can_rig.cli.output import counting, json_line, say, show, show_beside, table
from can_rig.errors import INTERRUPTED, WorkersLostError
from can_rig.nodes.bus_access import StopRequest

TWICE_S: Final = 0.5
"""A second signal within this time is the same Ctrl-C: terminal and wrapper may both send one."""


@click.command("campaign")
@click.argument("campaign", metavar="CAMPAIGN")
@click.option(
    "--scenario",
    "scenarios",
    metavar="NAME",
    multiple=True,
    help="Scenario of the runs, in place of the campaign's own; repeatable.",
)
@set_option("Change one key of the scenario in every run")
@click.option(
    "--runs", type=click.IntRange(1), help="Number of runs, in place of the campaign's own."
)
@click.option("--seed", type=click.IntRange(0), help="Seed, in place of the campaign's own.")
@click.option(
    "--workers",
    type=click.IntRange(1),
    help="Number of processes, which does not change the result.  [default: the cores]",
)
@click.option(
    "--scheduler", metavar="ADDRESS", help="Scheduler of a Dask cluster, in place of --workers."
)
@click.option(
    "--search",
    metavar="REQUIREMENT",
    help="Look for the runs that fail this requirement worst (all: any requirement), beside as "
    "many random runs.",
)
@click.option("--out", type=click.Path(path_type=Path), help="Folder [campaigns/CAMPAIGN-TIME].")
@click.option("--resume", is_flag=True, help="Continue the campaign in --out.")
@click.option("--force", is_flag=True, help="Replace the campaign in --out.")
@json_option("The summary as one JSON object.")
def command(
    campaign: str,
    scenarios: tuple[str, ...],
    settings: tuple[str, ...],
    runs: int | None,
    seed: int | None,
    workers: int | None,
    scheduler: str | None,
    search: str | None,
    out: Path | None,
    resume: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Run a campaign of thousands of runs.

    CAMPAIGN is a TOML file or a shipped one: cars, double-faults, faults, hours, latency, losses,
    restarts, weather. Every run becomes a row of runs.parquet with the command that repeats the
    run; report.html gives the pass rate of each requirement, the worst runs, the campaign's tables,
    and the influence of each axis. Ctrl-C keeps completed runs, and once more waits for no run.
    """
    if resume and (out is None or force):
        raise click.UsageError("--resume: must come with --out, and not with --force")
    if scheduler is not None and workers is not None:
        raise click.UsageError("--scheduler: must come without --workers")
    keys = {"scenario": list(scenarios) or None, "runs": runs, "seed": seed, "search": search}
    planned = plan(read_campaign(campaign, settings, **keys))
    folder = open_folder(out, planned, resume=resume, force=force)
    click.get_current_context().call_on_close(folder.made.close)
    stop = StopRequest().on_signals()
    _end_at_the_second_ctrl_c(stop)
    cores = min(workers or len(os.sched_getaffinity(0)), planned.runs)
    with counting(planned.settings.name, "runs", planned.runs) as on_done, _told(folder):
        whole = execute(folder, computing(planned, cores, scheduler), lambda: stop.wanted, on_done)
    if not whole:
        say(
            f"{folder.done} of {planned.runs} runs are done; "
            f"--resume --out {folder.made.path} goes on"
        )
        sys.exit(INTERRUPTED)
    with _told(folder):
        summary = write_report(folder)
        folder.made.publish()
    if as_json:
        json_line(folder=str(folder.path), **asdict(summary))
    else:
        _print(summary, folder)
    sys.exit(0 if summary.passed else 1)


def _end_at_the_second_ctrl_c(stop: StopRequest) -> None:
    """The first Ctrl-C waits for the runs under way, of which a user's class may never end."""
    first_s: list[float] = []

    def want(_signal: int, _frame: FrameType | None) -> None:
        if first_s and time.monotonic() - first_s[0] > TWICE_S:
            os._exit(INTERRUPTED)  # whole blocks stay; workers end with this process
        first_s[:] = first_s or [time.monotonic()]
        stop.wanted = True

    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # nohup
        signal.signal(signal.SIGINT, want)


def computing(
    planned: Plan, workers: int, scheduler: str | None
) -> AbstractContextManager[Compute]:
    """Who computes the runs."""
    if scheduler is not None:
        from can_rig.campaigns.cluster import on_cluster  # noqa: PLC0415 (an extra)

        return on_cluster(planned, scheduler)
    if workers == 1:
        return serially(planned)
    return in_processes(planned, workers)


@contextmanager
def _told(folder: CampaignFolder) -> Iterator[None]:
    """Print the campaign's folder at any end of the campaign; remove a folder without runs."""
    try:
        yield
    except BaseException as error:
        if folder.done == 0:
            folder.made.give_up()
        else:
            say(f"campaign folder  {folder.path}")
            if isinstance(error, WorkersLostError):
                error.args = (f"{error}; what is done is kept, and --resume goes on",)
        raise


def _found(summary: Summary) -> Table:
    found = table("chosen by", "runs", "least margin", "failed", "first failed at", left=1)
    for each in summary.found:
        least = "-" if each.least is None else f"{each.least:.4g}"
        first = "-" if each.first_failed is None else str(each.first_failed)
        found.add_row(each.method, str(each.runs), least, str(each.failed), first)
    return found


def _show_cross(cross: Cross) -> None:
    requirements = [each.name for each in cross.rows[0].rates] if cross.rows else []
    columns = [name.replace("_", " ").lower() for name in cross.columns]
    fails = [f"{name} fails" for name in requirements]
    rows = []
    for row in cross.rows:
        counts = (str(row.counts.get(name, "")) for name in cross.columns)
        failed = ("-" if rate.share is None else str(rate.failed or "") for rate in row.rates)
        rows.append((row.name, str(row.runs), *counts, *failed))
    say("")
    show_beside((cross.of_rows, "runs", *columns, *fails), *rows)


def _print(summary: Summary, folder: CampaignFolder) -> None:
    rates = table("requirement", "passed", "failed", "without", "rate", "95 %", "", left=1)
    rates.columns[-1].justify = "left"
    for rate in summary.rates:
        interval = "-" if rate.low is None else f"{percent(rate.low)} .. {percent(rate.high)}"
        numbers = (str(number) for number in (rate.passed, rate.failed, rate.unknown))
        rates.add_row(rate.name, *numbers, percent(rate.share), interval, rate.text)
    spreads = table("metric", "runs", "least", "median", "99 %", "greatest")
    for each in summary.spreads:
        values = (each.least, each.median, each.percentile_99, each.greatest)
        spreads.add_row(each.name, str(each.runs), *(f"{number:.4g}" for number in values))
    show(rates, spreads, *([_found(summary)] if summary.found else []), wide=True)
    for cross in summary.tables:
        _show_cross(cross)
    alarms = summary.false_alarms
    if alarms["per_hour"] is not None:
        say(
            f"false alarms  {alarms['false_alarms']} in {alarms['hours']:.4g} h without a loss, "
            f"{alarms['per_hour']:.3g} an hour (95 %: {alarms['low']:.3g} .. {alarms['high']:.3g})"
        )
    if summary.failed:
        say(f"{summary.failed} of {summary.runs} runs have no result")
    for reason, count in list(summary.reasons.items())[:3]:
        say(f"{count} of them: {reason}")
    if summary.worst:
        say(f"worst run  {summary.worst[0]['command']}")
    say(f"campaign folder  {folder.path}")
