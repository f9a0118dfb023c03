"""``can-rig convert``: a log in another format."""

from pathlib import Path

import click

from can_rig.cli.options import (
    channel_option,
    force_option,
    json_option,
    log_argument,
    window_options,
)
from can_rig.cli.output import json_line, note, reading, say
from can_rig.logs.frames import window_of
from can_rig.logs.reading import read_log
from can_rig.logs.writing import refuse_log, write_log
from can_rig.results.source import log_path, only_channel
from can_rig.storage.files import refuse_itself


@click.command("convert")
@log_argument
@click.argument("out", type=click.Path(path_type=Path, dir_okay=False))
@window_options
@channel_option
@force_option
@json_option()
def command(
    log: Path,
    out: Path,
    from_s: float | None,
    to_s: float | None,
    channel: str | None,
    force: bool,
    as_json: bool,
) -> None:
    """Write LOG, a log of any format or a run folder, as OUT in the format of its suffix.

    One line names each detail that OUT drops or changes. Frames of a kind unknown to the format of
    OUT are refused.
    """
    source = read_log(log_path(log), window=window_of(from_s, to_s))
    refuse_log(out, force, "OUT")
    refuse_itself(source.path, out)
    changes = write_log(
        source,
        out,
        lambda log: only_channel(reading(log, "converting"), channel, log.path),
        force=force,
    )
    if as_json:
        json_line(
            log=str(source.path),
            out=str(out),
            frames=changes.frames,
            buses=changes.buses,
            changes=changes.lines(),
            notice=source.notice,
        )
    else:
        say(f"{changes.frames} frames in {out}")
        note(*changes.lines(), source.notice)
