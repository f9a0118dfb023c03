"""``can-rig figures``."""

from pathlib import Path

import click

from can_rig.cli.options import set_option
from can_rig.cli.output import say, show, table
from can_rig.thesis import figures
from can_rig.thesis.comparisons import compare, compare_scenario


@click.command("figures")
@click.argument("own", metavar="[SCENARIO]", required=False)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default="figures",
    show_default=True,
    help="Folder of the PNG files.",
)
@set_option("Change one key of every figure's scenario")
@click.option("--force", is_flag=True, help="Replace figures that exist.")
def command(own: str | None, out: Path, settings: tuple[str, ...], force: bool) -> None:
    """Draw Figs. 2.2-2.4, 3.5, 3.6 of the thesis: the firmware over the continuous loop.

    With SCENARIO, draw the counterparts of Figs. 2.2-2.4 for SCENARIO's plant: the fault estimate
    without a fault and with channel 1 lost from the start, and the effect of compensation.
    """
    if own is None:
        figures.refuse_existing(out, force)
        comparisons = compare(settings)
    else:
        comparisons = compare_scenario(own, settings)
    headings = ("figure", "signal", "whole run", "of its size", "after the loss", "tick")
    distances = table(*headings, left=2, title="largest distance, sampled - continuous")
    for comparison in comparisons:
        tick = f"{comparison.scenario.tick_s * 1e3:g} ms"
        for curve in comparison.curves:
            distance, after = comparison.distance(curve), comparison.distance_after_loss(curve)
            distances.add_row(
                comparison.figure,
                curve.name,
                f"{distance:.2e} {comparison.unit}".rstrip(),
                f"{distance / comparison.size:.1e}",
                "" if after is None else f"{after:.2e} {comparison.unit}".rstrip(),
                tick,
            )
    figures.draw_figures(out, comparisons, force)
    show(distances)
    say(f"figures in {out}")
