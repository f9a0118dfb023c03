"""``can-rig inject``: one command to a plant node started with --injectable."""

import re
from typing import Final

import click

from can_rig.buses.bus import open_bus
from can_rig.cli.options import bus_of_processes, bus_option
from can_rig.cli.output import say
from can_rig.frames import operator_frames
from can_rig.nodes.operating import operate
from can_rig.plant.faults.injection import kinds_of
from can_rig.scenario.fault_settings import CHANNELS
from can_rig.scenario.sensor_settings import MEASURED

DO: dict[str, operator_frames.Action] = {
    "clear": "CLEAR",
    "reference": "MOVE_REFERENCE",
    "pace": "PACE",
    "pause": "PAUSE",
    "step": "STEP",
}

NEGATIVE: Final = re.compile(r"-\.?\d")


def _kinds(place: str) -> dict[str, str]:
    """What can be wrong with ``place``: the word on the command line → the kind."""
    prefix = "actuator-" if place in CHANNELS else "sensor-"
    return {kind.removeprefix(prefix): kind for kind in kinds_of(place)}


class _WithNegatives(click.Command):
    """A command with negative numbers as arguments, although such numbers look like options."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Take negative numbers for arguments where no option asks for its value."""
        options = {name for each in self.params for name in each.opts if name.startswith("-")}
        numbers = [
            at
            for at, word in enumerate(args)
            if NEGATIVE.match(word) and not (at and args[at - 1] in options)
        ]
        if numbers and "--" not in args:
            rest = [word for at, word in enumerate(args) if at not in numbers]
            args = [*rest, "--", *(args[at] for at in numbers)]
        return super().parse_args(ctx, args)


@click.command("inject", cls=_WithNegatives)
@click.argument("what", type=click.Choice([*operator_frames.places(), *DO]), metavar="WHAT")
@click.argument("how", required=False)
@bus_option("local", "local", bus_of_processes)
@click.option(
    "--for",
    "for_s",
    type=click.FloatRange(operator_frames.SHORTEST_S, operator_frames.LONGEST_S),
    metavar="S",
    help=f"Duration in seconds, {operator_frames.SHORTEST_S:g} to "
    f"{operator_frames.LONGEST_S:g} in steps of 0.1.  [default: until cleared]",
)
@click.option(
    "--value",
    type=float,
    help="The number of a fault, in the unit of the failing signal, or the size of a disturbance.",
)
@click.option("--with", "other", type=click.Choice(MEASURED), help="The sensor swapped with WHAT.")
def command(
    what: str,
    how: str | None,
    bus: str,
    for_s: float | None,
    value: float | None,
    other: str | None,
) -> None:
    """Inject or clear a fault or a disturbance in a running simulation: inject torque dead --for 2.

    An actuator, torque or force-difference, is dead (--value: the remaining share), stuck, offset,
    drift, oscillating, rate-limited or late. The sensor of D*, sensor, is biased in place of
    offset, and may be scaled.

    A further sensor of the scenario (yaw-rate, lateral-acceleration, steering-angle, torque-echo,
    force-difference-echo) may also be invalid, tick-stuck or swapped (--with), and an echo lying.

    The frames of each may be frames-missing, -corrupted, -repeated, -late or -forged.

    world HOW pushes the plant with --value: gust (N, 0.3 m ahead of the centre of gravity),
    turbulence (N rms over 50 m), bank (%), friction (a factor), steering-kick (N m); push, for a
    plant other than a car.

    clear ends all faults and disturbances, clear WHAT the faults and disturbances of WHAT.
    reference MPS2 adds to the scenario's reference. pace X holds the run to X times real time, and
    ends a pause. pause stops the run, and step TICKS lets a paused run go on for so many ticks.
    """
    if (other is None) == (how == "swapped"):
        raise click.UsageError("--with: must name the other sensor of a swap, and nothing else")
    if other is not None:
        value = operator_frames.places().index(other)
    asked = _command(what, how, for_s, value)
    with open_bus(bus) as opened:
        operate(opened, bus, asked)
    say(f"{_said(what, how)}: done")


def _said(what: str, how: str | None) -> str:
    return what if how is None else f"{what} {how}"


def _command(
    what: str, how: str | None, for_s: float | None, value: float | None
) -> operator_frames.Command:
    if what in operator_frames.places():
        kinds = _kinds(what)
        if how not in kinds:
            raise click.UsageError(f"{_said(what, how)}: must be one of {', '.join(kinds)}")
        return operator_frames.Command("INJECT", kinds[how], what, value, for_s)
    if for_s is not None or value is not None:
        raise click.UsageError(f"{what}: --for and --value are of faults and disturbances")
    if what == "clear":
        place = how or operator_frames.ALL
        if place not in (operator_frames.ALL, *operator_frames.places()):
            raise click.UsageError(
                f"clear {how}: must be one of {', '.join(operator_frames.places())}, "
                "or nothing for all"
            )
        return operator_frames.Command("CLEAR", place=place)
    if what == "pause":
        if how is not None:
            raise click.UsageError(f"pause {how}: nothing must follow; pace goes on")
        return operator_frames.Command("PAUSE")
    try:
        number = float(how if how is not None else "1" if what == "step" else "")
    except ValueError:
        raise click.UsageError(f"{_said(what, how)}: must be followed by a number") from None
    return operator_frames.Command(DO[what], value=number)
