"""``can-rig plot``: signals of any log through any DBC, drawn for print."""

from pathlib import Path

import click

from can_rig.cli.decoding import Asked, decoding_options
from can_rig.cli.options import force_option, out_option
from can_rig.cli.output import note, reading, say
from can_rig.decoding.decode import Databases, Decoder
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
    wanted = [resolve(databases, name) for name in signals]
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


def resolve(databases: Databases, name: str) -> tuple[str, str]:
    """Message and signal for ``MESSAGE.Signal``, or for ``Signal`` of a single message.

    Raises:
        DbcError: no message or several messages have the signal.
    """
    messages = Decoder(databases, None, {name}).messages
    found = [(message, signal) for message in messages for signal in messages[message].signals]
    if not found:
        raise DbcError(f"signal {name} does not lie within its message")
    if len(found) > 1:
        places = " or ".join(".".join(pair) for pair in found[:4])
        raise DbcError(f"signal {name} is in more than one message; must be {places}")
    return found[0]


def _bare(path: Path) -> str:
    """The name of a log without the suffixes of its format."""
    name = path.resolve().name.removesuffix(".gz")
    return name if path.is_dir() else Path(name).stem
