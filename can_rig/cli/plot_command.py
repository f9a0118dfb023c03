"""``can-rig plot``: signals of any log through any DBC, drawn for print."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from cantools.database.can import Database
from rich.console import Console

from can_rig.cli.diff_command import refuse_picture
from can_rig.cli.progress import reading
from can_rig.decoding.decode import Decoder, load_database
from can_rig.decoding.message_columns import MessageColumns, joined
from can_rig.errors import DbcError, LogError, ScenarioError
from can_rig.files import atomic
from can_rig.frames.messages import shipped_dbc
from can_rig.logs.reading import read_log
from can_rig.results.source import log_path, source_of
from can_rig.views.signal_table import fault_of

CAR: Final = "steer_by_wire.dbc"


def plot_command(
    path: Path,
    names: Sequence[str],
    dbc: Path | None,
    strict: bool,
    channel: str | None,
    out: Path | None,
    force: bool,
) -> int:
    """Draw signals of a log: the exit status.

    Raises:
        LogError: the log cannot be read, the picture not be written, or there is nothing to draw.
        DbcError: the DBC cannot be read, or has no such signal.
    """
    out = out or Path(f"{_bare(path)}.png")
    refuse_picture(out, force)
    database = load_database(dbc or _own_dbc(path), strict)
    wanted = [resolve(database, name) for name in names]
    decoder = Decoder(database, None, {f"{m}.{s}" for m, s in wanted}, channel)
    log = read_log(log_path(path))
    parts: dict[str, list[MessageColumns]] = {}
    for frames in reading(log, "reading"):
        for name, columns in decoder.decode(frames).items():
            parts.setdefault(name, []).append(columns)
    found = {name: joined(columns) for name, columns in parts.items()}
    drawn = [pair for pair in wanted if len(found.get(pair[0], ()))]
    absent = sorted({message for message, _ in wanted if not len(found.get(message, ()))})
    if not drawn:
        raise LogError(
            decoder.nothing_on_channel
            or f"{log.path}: no frame of {', '.join(absent)} in it that can be decoded"
        )
    from can_rig.views.plot_picture import plot_page  # noqa: PLC0415 (matplotlib)

    fault = fault_of(path) if path.is_dir() else None
    page = plot_page(found, drawn, log.start_ns, fault)
    with atomic(out) as part:
        page.savefig(part, dpi=150, format="png")
    notes = Console(stderr=True, soft_wrap=True)
    for note in (log.notice, f"no frame of {', '.join(absent)}" if absent else None):
        if note:
            notes.print(f"note: {note}", style="yellow", markup=False, highlight=False)
    Console(soft_wrap=True).print(f"picture in {out}", markup=False, highlight=False)
    return 0


def resolve(database: Database, name: str) -> tuple[str, str]:
    """Message and signal of ``MESSAGE.Signal``, or of ``Signal`` where only one message has it.

    Raises:
        DbcError: there is none, or more than one.
    """
    every = [
        (message.name, signal.name) for message in database.messages for signal in message.signals
    ]
    found = [pair for pair in every if name in (pair[1], ".".join(pair))]
    if len(found) == 1:
        return found[0]
    if found:
        raise DbcError(
            f"signal {name} is in more than one message; "
            f"{' or '.join('.'.join(pair) for pair in found[:4])} is right"
        )
    by_lower = {}
    for pair in every:
        by_lower[pair[1].lower()] = pair[1]
        by_lower[".".join(pair).lower()] = ".".join(pair)
    near = difflib.get_close_matches(name.lower(), by_lower, 3, 0.5)
    hint = " or ".join(by_lower[key] for key in near)
    raise DbcError(
        f"no signal {name} in the database; "
        + (f"did you mean {hint}?" if hint else f"it has {', '.join(s for _, s in every[:6])}, …")
    )


def _bare(path: Path) -> str:
    """The name of a log without what says its format."""
    name = path.resolve().name.removesuffix(".gz")
    return name if path.is_dir() else Path(name).stem


def _own_dbc(path: Path) -> Path:
    """The DBC of a run folder's scenario; otherwise that of the car."""
    try:
        return shipped_dbc(source_of(path, None, ()).scenario.dbc if path.is_dir() else CAR)
    except ScenarioError:  # a run that was killed before its run.json
        return shipped_dbc(CAR)
