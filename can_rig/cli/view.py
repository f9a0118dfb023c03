"""``can-rig view``: a run or a log as a page with every signal, in a browser, without network."""

from __future__ import annotations

import tempfile
import webbrowser
from pathlib import Path

import click

from can_rig.cli.decoding import Asked, decoding_options
from can_rig.cli.options import force_option
from can_rig.cli.output import note, reading, say
from can_rig.errors import LogError
from can_rig.files import atomic, refuse_existing
from can_rig.logs.frames import ALL
from can_rig.results.source import read_run


@click.command("view")
@decoding_options
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write the page, FILE.html, and open no browser.",
)
@force_option
def command(asked: Asked, out: Path | None, force: bool) -> None:
    """Show LOG in a browser: a run folder with its plant in motion, or a log through any DBC.

    A run folder with --dbc, --channel, --from or --to is shown as a log.
    """
    if out is not None:
        refuse_existing(out, force, "--out")
    if asked.path.is_dir() and not (asked.named or asked.channel or asked.window != ALL):
        from can_rig.views.bench_page import page_of_run  # noqa: PLC0415

        text = page_of_run(*read_run(asked.path))
    else:
        text = _of_log(asked)
    if out is None:
        out = Path(tempfile.mkdtemp(prefix="can-rig-")) / "view.html"
        out.write_text(text, encoding="utf-8")
        webbrowser.open(out.as_uri())
    else:
        with atomic(out, force=force) as part:
            part.write_text(text, encoding="utf-8")
    say(f"page in {out}")


def _of_log(asked: Asked) -> str:
    from can_rig.decoding.decode import Decoder  # noqa: PLC0415
    from can_rig.views.bench_page import page_of_log  # noqa: PLC0415

    decoder = Decoder(asked.databases(), channel=asked.channel)
    source = asked.log()
    found = decoder.whole(reading(source, "reading"))
    if not found:
        nothing = decoder.nothing_on_channel or "no frame of the database's messages"
        raise LogError(f"{source.path}: {nothing}; name the database with --dbc")
    note(source.notice)
    return page_of_log(asked.path, found, source.start_ns)
