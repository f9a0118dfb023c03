"""``can-rig plot``: signals of any log through any DBC, drawn for print."""

import difflib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import click

from can_rig.cli.decoding import Asked, decoding_options
from can_rig.cli.options import force_option, out_option
from can_rig.cli.output import note, reading, say
from can_rig.decoding.decode import Decoder
from can_rig.decoding.message_decoder import MessageDecoder
from can_rig.errors import DbcError, LogError
from can_rig.storage.files import atomic, refuse_picture
from can_rig.views.pictures import plot_page
from can_rig.views.signal_table import scenario_of


@click.command("plot")
@decoding_options
@click.argument("signals", nargs=-1, required=True, metavar="SIGNAL...")
@out_option("The picture, FILE.png, .svg or .pdf.  [default: the log's name, .png]")
@force_option
def command(asked: Asked, signals: tuple[str, ...], out: Path | None, force: bool) -> None:
    """Draw SIGNALs of LOG: MESSAGE.Signal, or Signal if a single message has it."""
    out = out or Path(f"{_bare(asked.path)}.png")
    refuse_picture(out, force)
    databases = asked.databases()
    every = Decoder(databases).messages
    wanted = [resolve(every, name) for name in signals]
    decoder = Decoder(databases, None, {f"{m}.{s}" for m, s in wanted}, asked.channel)
    source = asked.log()
    found = decoder.whole(reading(source, "reading"))
    drawn = [pair for pair in wanted if len(found.get(pair[0], ()))]
    absent = sorted({message for message, _ in wanted if not len(found.get(message, ()))})
    if not drawn:
        nothing = decoder.nothing_on_channel or f"no frame of {', '.join(absent)} can be decoded"
        raise LogError(f"{source.path}: {nothing}")
    page = plot_page(found, drawn, source.start_ns, scenario_of(asked.path))
    with atomic(out, force=force) as part:
        page.savefig(part, dpi=150)
    note(source.notice, f"no frame of {', '.join(absent)}" if absent else None)
    say(f"picture in {out}")


def resolve(messages: Mapping[str, MessageDecoder], name: str) -> tuple[str, str]:
    """Message and signal for ``MESSAGE.Signal``, or for ``Signal`` of a single message.

    Raises:
        DbcError: no message or several messages have the signal.
    """
    every = [(message, signal) for message in messages for signal in messages[message].signals]
    found = [pair for pair in every if name in (pair[1], ".".join(pair))]
    if len(found) == 1:
        return found[0]
    if found:
        raise DbcError(
            f"signal {name} is in more than one message; "
            f"must be {' or '.join('.'.join(pair) for pair in found[:4])}"
        )
    by_lower = {}
    for pair in every:
        by_lower[pair[1].lower()] = pair[1]
        by_lower[".".join(pair).lower()] = ".".join(pair)
    near = difflib.get_close_matches(name.lower(), by_lower, 3, 0.5)
    hint = " or ".join(by_lower[key] for key in near)
    if not hint:  # of the rig's messages each has a checksum, a counter and a tick
        often = Counter(signal for _, signal in every)
        hint = ", ".join([signal for signal in often if often[signal] == 1][:6]) or "none"
        raise DbcError(f"no signal {name} in the database; it has {hint}, …")
    raise DbcError(f"no signal {name} in the database; did you mean {hint}?")


def _bare(path: Path) -> str:
    """The name of a log without the suffixes of its format."""
    name = path.resolve().name.removesuffix(".gz")
    return name if path.is_dir() else Path(name).stem
