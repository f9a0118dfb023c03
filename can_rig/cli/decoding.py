"""Options of the commands that decode a log: the part of the log, and the databases."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, Final

import click

from can_rig.cli.options import channel_option, log_argument, window_options
from can_rig.cli.output import reading
from can_rig.decoding.decode import Databases, Decoder
from can_rig.frames.databases import load_database, load_for, shipped_dbc
from can_rig.logs.frames import Frames, Log, Window, window_of
from can_rig.logs.reading import read_log
from can_rig.results.run_folder import LOG
from can_rig.results.source import log_path, only_channel
from can_rig.scenario.build import dbc_of
from can_rig.views.signal_table import scenario_of

CAR: Final = "steer_by_wire.dbc"


@dataclass(frozen=True)
class Asked:
    """What a command shall decode.

    Attributes:
        path: a log, or a run folder.
        named: the databases, each ``FILE`` or ``BUS=FILE``; none: the log's own.
        strict: refuse a DBC whose signals overlap.
        channel: the only bus; None: all buses.
        window: the part of the log.
    """

    path: Path
    named: tuple[str, ...]
    strict: bool
    channel: str | None
    window: Window

    def log(self) -> Log:
        """The log.

        Raises:
            LogError: the log is missing, or cannot be read.
        """
        return read_log(log_path(self.path), window=self.window)

    def frames(self, log: Log, doing: str) -> Iterator[Frames]:
        """The chunks of ``log``, with a bar that says what the command is ``doing``."""
        return only_channel(reading(log, doing), self.channel, log.path)

    def databases(self) -> Databases:
        """The databases.

        Raises:
            DbcError: a database cannot be loaded.
        """
        if not self.named:
            dbc = own_dbc(self.path)
            return load_for(dbc, ()) if self.strict else load_database(dbc, False)
        return [
            (bus, load_database(file, self.strict)) for bus, file in map(bus_and_file, self.named)
        ]


def hint(asked: Asked, decoder: Decoder) -> str | None:
    """A line where a log without --dbc has frames by the rig's names, none of them the rig's."""
    foreign = [name for name, of in decoder.counts.items() if of.frames and not of.decoded]
    if asked.named or asked.path.is_dir() or not foreign:
        return None
    return (
        f"no frame of {', '.join(foreign)} is intact, by the rig's own database; "
        "--dbc names the log's"
    )


def bus_and_file(name: str) -> tuple[str | None, str]:
    """Bus and file of ``BUS=FILE``; no bus for ``FILE``, which may have an equals sign."""
    bus, equals, file = name.partition("=")
    return (bus, file) if equals and not Path(name).exists() else (None, name)


def own_dbc(source: Path) -> Path:
    """The DBC of a run folder's scenario, also where its log is named; else that of the car."""
    if not source.is_dir() and source.name.removesuffix(".gz") != LOG:
        return shipped_dbc(CAR)
    run = scenario_of(source if source.is_dir() else source.parent)
    return shipped_dbc(CAR) if run is None else dbc_of(run)  # None: killed before run.json


def decoding_options(function: Callable[..., None]) -> Callable[..., None]:
    """LOG, --dbc, --no-strict, --channel, --from and --to: the first argument of ``function``."""

    @wraps(function)
    def command(
        log: Path,
        dbc: tuple[str, ...],
        no_strict: bool,
        channel: str | None,
        from_s: float | None,
        to_s: float | None,
        **others: Any,
    ) -> None:
        function(Asked(log, dbc, not no_strict, channel, window_of(from_s, to_s)), **others)

    for decorate in (
        window_options,
        channel_option,
        click.option("--no-strict", is_flag=True, help="Accept a DBC whose signals overlap."),
        click.option(
            "--dbc",
            multiple=True,
            metavar="[BUS=]FILE",
            help="A DBC, or another database that cantools reads; of one bus alone with its name "
            "before it, as in can0=car.dbc.  Repeatable.  [default: the rig's own]",
        ),
        log_argument,
    ):
        command = decorate(command)
    return command
