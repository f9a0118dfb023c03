"""``can-rig view``: a run or a log as a page with every signal, in a browser, without network."""

from __future__ import annotations

import tempfile
import webbrowser
from pathlib import Path

import click

from can_rig.cli.databases import databases_of
from can_rig.cli.options import (
    channel_option,
    dbc_options,
    force_option,
    log_argument,
    window_options,
)
from can_rig.cli.output import note, reading, say
from can_rig.errors import LogError
from can_rig.files import atomic, refuse_existing


@click.command("view")
@log_argument
@dbc_options
@channel_option
@window_options
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write the page, FILE.html, and open no browser.",
)
@force_option
def command(
    log: Path,
    dbc: tuple[str, ...],
    no_strict: bool,
    channel: str | None,
    from_s: float | None,
    to_s: float | None,
    out: Path | None,
    force: bool,
) -> None:
    """Show LOG in a browser: a run folder with its plant in motion, or a log through any DBC.

    A run folder with --dbc, --channel, --from or --to is shown as a log.
    """
    if out is not None:
        refuse_existing(out, force, "--out")
    options = dbc or channel or from_s is not None or to_s is not None
    if log.is_dir() and not options:
        from can_rig.results.source import read_run  # noqa: PLC0415 (compiles)
        from can_rig.views.bench_page import page_of_run  # noqa: PLC0415

        text = page_of_run(*read_run(log))
    else:
        text = _of_log(log, dbc, no_strict, channel, from_s, to_s)
    if out is None:
        out = Path(tempfile.mkdtemp(prefix="can-rig-")) / "view.html"
        out.write_text(text, encoding="utf-8")
        webbrowser.open(out.as_uri())
    else:
        with atomic(out, force=force) as part:
            part.write_text(text, encoding="utf-8")
    say(f"page in {out}")


def _of_log(
    log: Path, dbc: tuple[str, ...], no_strict: bool, channel: str | None,
    from_s: float | None, to_s: float | None,
) -> str:  # fmt: skip
    from can_rig.decoding.decode import Decoder  # noqa: PLC0415
    from can_rig.logs.frames import window_of  # noqa: PLC0415
    from can_rig.logs.reading import read_log  # noqa: PLC0415
    from can_rig.results.source import log_path  # noqa: PLC0415
    from can_rig.views.bench_page import page_of_log  # noqa: PLC0415

    decoder = Decoder(databases_of(log, dbc, not no_strict), None, None, channel)
    source = read_log(log_path(log), window=window_of(from_s, to_s))
    found = decoder.whole(reading(source, "reading"))
    if not found:
        nothing = decoder.nothing_on_channel or "no frame of the database's messages"
        raise LogError(f"{source.path}: {nothing}; name the database with --dbc")
    note(source.notice)
    return page_of_log(log, found, source.start_ns)
