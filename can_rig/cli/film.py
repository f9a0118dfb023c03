"""``can-rig film``: a run as an animated picture."""

from pathlib import Path

import click

from can_rig.cli.options import force_option, out_option, window_options
from can_rig.cli.output import say
from can_rig.errors import LogError
from can_rig.results.source import read_run
from can_rig.storage.files import atomic, refuse_existing


@click.command("film")
@click.argument("run", type=click.Path(path_type=Path))
@out_option("The film, FILE.gif or FILE.mp4; an MP4 needs ffmpeg.", required=True)
@window_options
@click.option(
    "--speed",
    type=click.FloatRange(0.01, 100.0),
    default=1.0,
    show_default=True,
    help="Seconds of the run in a second.",
)
@click.option(
    "--rate",
    type=click.FloatRange(1.0, 50.0),
    default=12.5,
    show_default=True,
    help="Pictures a second.",
)
@force_option
def command(
    run: Path,
    out: Path,
    from_s: float | None,
    to_s: float | None,
    speed: float,
    rate: float,
    force: bool,
) -> None:
    """Draw RUN, a run folder, as a film: the car on its lane, or another plant in motion.

    Without --from and --to, the film has the time from 2 s before the first fault to 6 s after.
    """
    from can_rig.results.motion import scene  # noqa: PLC0415 (compiles)
    from can_rig.views.film import pictures, refuse_film, span_of, write_film  # noqa: PLC0415

    refuse_film(out)
    refuse_existing(out, force, "--out")
    scenario, _, signals = read_run(run)
    drawn = scene(scenario, signals)
    if drawn is None or len(drawn["columns"]["time"]) < 2:
        raise LogError(f"{run}: too short: a film needs a run of two ticks and more than 0.02 s")
    begin_s, end_s = span_of(drawn)
    begin_s, end_s = (begin_s if from_s is None else from_s), (end_s if to_s is None else to_s)
    last_s = float(drawn["columns"]["time"][-1])
    if not begin_s < min(end_s, last_s):
        said = f"--to {end_s:g}" if end_s < last_s else f"{last_s:g} s, the end of the run"
        raise LogError(f"--from {begin_s:g}: must be below {said}")
    with atomic(out, force=force) as part:
        write_film(part, out.suffix.lower(), pictures(drawn, begin_s, end_s, rate, speed), rate)
    say(f"film in {out}")
