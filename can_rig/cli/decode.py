"""``can-rig decode``: a log through a DBC, into files, with an account of the undecoded frames."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import click

from can_rig.cli.decoding import Asked, decoding_options, hint
from can_rig.cli.options import force_option, json_option
from can_rig.cli.output import json_line, note, reading, say, show, table
from can_rig.decoding.decode import Decoder
from can_rig.decoding.files import decode_to_files, refuse_output
from can_rig.logs.frames import Log
from can_rig.storage.files import refuse_itself

_SHOWN: Final = 5  # unknown identifiers in the table


@click.command("decode")
@decoding_options
@click.option(
    "--out",
    "outputs",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="FILE.csv: one table, a row a frame; FOLDER.parquet: a folder of Parquet files, one a "
    "message; a name without suffix: a folder of CSV files, one a message; FILE.mf4: a group a "
    "message; FILE.mcap: a channel a message.  Repeatable.",
)
@click.option(
    "--message", "messages", multiple=True, metavar="NAME", help="Only this message; repeatable."
)
@click.option(
    "--signal",
    "signals",
    multiple=True,
    metavar="NAME",
    help="Only this signal, as Signal or Message.Signal; repeatable.",
)
@click.option("--relative", is_flag=True, help="Count time from the start of the recording.")
@click.option(
    "--names",
    is_flag=True,
    help="Write the words of value tables, not their codes; an MF4 always has the codes, with the "
    "words as comments.",
)
@force_option
@json_option("The counts as one JSON object.")
def command(
    asked: Asked,
    outputs: tuple[Path, ...],
    messages: tuple[str, ...],
    signals: tuple[str, ...],
    relative: bool,
    names: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Decode LOG, a log of any format or a run folder, through a DBC.

    Prints for every message the number of frames, decoded and undecoded: too short, repeated,
    damaged, unknown.
    """
    source, databases = asked.log(), asked.databases()
    for path in outputs:
        refuse_output(path, force)
    refuse_itself(source.path, *outputs)
    making = partial(Decoder, databases, messages or None, signals or None, asked.channel)
    decoder = decode_to_files(
        source, making, outputs, reading, relative=relative, names=names, force=force
    )
    if as_json:
        json_line(**_summary(source, decoder, outputs))
    else:
        _print(decoder, outputs)
    note(
        source.notice,
        hint(asked, decoder),
        *(f"{name} does not lie within its message" for name in decoder.left_out),
    )


def _summary(log: Log, decoder: Decoder, outputs: Sequence[Path]) -> dict[str, Any]:
    return {
        "log": str(log.path),
        "frames": decoder.frames,
        "messages": {n: c.as_dict() for n, c in decoder.counts.items() if c.frames},
        "unknown": dict(decoder.unknown.most_common()),
        "error_frames": decoder.error_frames,
        "not_wanted": decoder.not_wanted,
        "transport": {
            "messages": decoder.transport.messages,
            "incomplete": decoder.transport.incomplete,
            "unknown": dict(decoder.transport.unknown.most_common()),
        },
        "notice": log.notice,
        "out": [str(path) for path in outputs],
    }


def _print(decoder: Decoder, outputs: Sequence[Path]) -> None:
    """Print one row for each received message, without empty columns."""
    counts = {name: c.as_dict() for name, c in decoder.counts.items() if c.frames}
    headings = ["frames", "decoded"]
    if counts:
        every = next(iter(counts.values()))
        headings += [h for h in every if h not in headings and any(c[h] for c in counts.values())]
    messages = table("message", *(heading.replace("_", " ") for heading in headings))
    for name, count in counts.items():
        messages.add_row(name, *(str(count[heading]) for heading in headings))
    show(messages)
    unknown = decoder.unknown.most_common(_SHOWN)
    if unknown:
        some = ", ".join(f"identifier 0x{digits}: {count}" for digits, count in unknown)
        more = ", …" if len(decoder.unknown) > len(unknown) else ""
        say(f"frames not in the database: {decoder.unknown.total()} ({some}{more})")
    transport = decoder.transport
    if transport.messages or transport.incomplete:
        say(
            f"J1939 messages put together: {transport.messages} (not in the database: "
            f"{transport.unknown.total()}), incomplete: {transport.incomplete}"
        )
    if decoder.error_frames:
        say(f"error frames: {decoder.error_frames}")
    if decoder.not_wanted:
        say(f"of other messages or buses: {decoder.not_wanted}")
    say(*(f"written  {path}" for path in outputs))
