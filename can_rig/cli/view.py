"""``can-rig view``: a run or a log as a page with every signal, in a browser, without network."""

from __future__ import annotations

import tempfile
import webbrowser
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from can_rig.cli.decoding import Asked, decoding_options
from can_rig.cli.options import force_option, out_option
from can_rig.cli.output import note, say
from can_rig.errors import LogError
from can_rig.logs.frames import ALL
from can_rig.results.source import read_run
from can_rig.storage.files import atomic, refuse_existing

if TYPE_CHECKING:
    from can_rig.drawing.bench import Recording


@click.command("view")
@decoding_options
@click.argument("other", type=click.Path(path_type=Path), required=False)
@out_option("Write the page, FILE.html, and open no browser.")
@force_option
def command(asked: Asked, other: Path | None, out: Path | None, force: bool) -> None:
    """Show LOG in a browser: a run folder with its plant in motion, or a log through any DBC.

    The curves of a second run or log, OTHER, are dotted beside the curves of LOG.  A run folder
    with --dbc, --channel, --from or --to is shown as a log, and so is a run beside a log.
    """
    if out is not None:
        if out.suffix.lower() not in {".html", ".htm"}:
            raise LogError(f"{out}: a page must be FILE.html")
        refuse_existing(out, force, "--out")
    from can_rig.views.bench_page import overlaid, page_of  # noqa: PLC0415

    every = [asked] if other is None else [asked, replace(asked, path=other)]
    as_logs = asked.named or asked.channel or asked.window != ALL
    as_runs = not as_logs and all(each.path.is_dir() for each in every)
    titles, recordings = zip(*(_of_run(e) if as_runs else _of_log(e) for e in every), strict=True)
    if other is None:
        text = page_of(titles[0], recordings[0])
    else:
        text = page_of(f"A: {asked.path}, lines; B: {other}, dotted", overlaid(*recordings))
    if out is None:
        out = Path(tempfile.mkdtemp(prefix="can-rig-")) / "view.html"
        out.write_text(text, encoding="utf-8")
        webbrowser.open(out.as_uri())
    else:
        with atomic(out, force=force) as part:
            part.write_text(text, encoding="utf-8")
    say(f"page in {out}")


def _of_run(asked: Asked) -> tuple[str, Recording]:
    from can_rig.drawing.names import names_of  # noqa: PLC0415
    from can_rig.results.report.page import page_title  # noqa: PLC0415
    from can_rig.views.bench_page import recording_of_run  # noqa: PLC0415

    scenario, network, signals = read_run(asked.path)
    title = page_title(scenario, names_of(scenario.plant), signals).split("\n")[0]
    return title, recording_of_run(scenario, network, signals, asked.log())


def _of_log(asked: Asked) -> tuple[str, Recording]:
    from can_rig.decoding.decode import Decoder  # noqa: PLC0415
    from can_rig.decoding.trace import Collected, Kinds  # noqa: PLC0415
    from can_rig.views.bench_page import recording_of_log  # noqa: PLC0415

    databases, source = asked.databases(), asked.log()
    decoder = Decoder(databases, channel=asked.channel)
    collected = Collected(Kinds(databases), source)
    found = decoder.whole(collected.passing(asked.frames(source, "reading")))
    if not found:
        nothing = decoder.nothing_on_channel or "no frame of the database's messages"
        raise LogError(f"{source.path}: {nothing}; --dbc names another database")
    note(source.notice)
    return asked.path.name, recording_of_log(found, source.start_ns, collected)
