"""Options that commands share."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

from can_rig.cli.output import only_json
from can_rig.controllers import CONTROLLERS, SERIAL
from can_rig.errors import BusError
from can_rig.nodes.interaction import Interaction
from can_rig.scenario import shipped

Completions = list[CompletionItem]
Function = TypeVar("Function", bound=Callable[..., Any])


def scenario_options(function: Function) -> Function:
    """SCENARIO and --set, for every command that examines or runs a scenario."""
    return scenario_argument(set_option("Change one key of the scenario")(function))


def _scenarios(_context: click.Context, _argument: click.Parameter, begun: str) -> Completions:
    """Shell completion: shipped scenarios and files."""
    names = [CompletionItem(name) for name in shipped() if name.startswith(begun)]
    return [CompletionItem(begun, type="file"), *names]


scenario_argument = click.argument("scenario", default="default", shell_complete=_scenarios)


def _keys(_context: click.Context, _option: click.Parameter, begun: str) -> list[str]:
    """Shell completion: the keys of a scenario."""
    from can_rig.scenario.settings import keys  # noqa: PLC0415 (pydantic)

    return [key for key in keys() if key.startswith(begun)]


def set_option(what: str) -> Callable[[Function], Function]:
    """--set, which does ``what``."""
    return click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="KEY=VALUE",
        shell_complete=_keys,
        help=f"{what}, as in plant.speed_mps=20; repeatable.",
    )


def above_zero(
    _context: click.Context, option: click.Parameter, value: float | None
) -> float | None:
    """Refuse a number or a time in seconds unless above 0."""
    if value is not None and not value > 0.0:  # nan too
        unit = " s" if option.metavar == "S" else ""
        raise click.BadParameter(f"{value:g}{unit}: must be above 0")
    return value


def bus_name(_context: click.Context, _option: click.Parameter, value: str | None) -> str | None:
    """Refuse a bus without a name: an unset variable turns --bus "$BUS" into an empty name."""
    if value is not None and not value.strip():
        raise click.BadParameter("must name a bus, such as local or socketcan:vcan0")
    return value


def bus_of_processes(
    context: click.Context, option: click.Parameter, value: str | None
) -> str | None:
    """Refuse also a bus within one process, where no other process is ever heard."""
    from can_rig.buses.bus import in_one_process  # noqa: PLC0415 (python-can is slow to import)

    name = bus_name(context, option, value)
    if name is not None and in_one_process(name):
        raise BusError(
            f"bus {name!r}: stays within one process, and the other node is another process; "
            "it must be the bus 'local' or another that they share"
        )
    return name


def bus_option(
    default: str | None, shown: str, callback: Callable[..., str | None] = bus_name
) -> Callable[[Function], Function]:
    """--bus, with its own default."""
    return click.option(
        "--bus",
        default=default,
        callback=callback,
        metavar="NAME",
        help="local[:NAME], socketcan:vcan0, udp_multicast:ADDRESS, or any python-can "
        f"INTERFACE:CHANNEL?KEY=VALUE.  [default: {shown}]",
    )


realtime_option = click.option(
    "--realtime",
    "real_time",
    is_flag=True,
    help="Absolute deadlines of the wall clock, one a tick; late commands count as lost. "
    "Needs a latency of at least one tick.",
)


def controller_name(context: click.Context, parameter: click.Parameter, value: str) -> str:
    """A name of ``CONTROLLERS``, or a serial port."""
    if value in CONTROLLERS or (value.startswith(SERIAL) and value != SERIAL):
        return value
    known = ", ".join([*CONTROLLERS, f"{SERIAL}PORT"])
    raise click.BadParameter(f"{value!r} is not one of {known}.", context, parameter)


controller_option = click.option(
    "--controller",
    default="python",
    callback=controller_name,
    shell_complete=lambda _c, _p, begun: [each for each in CONTROLLERS if each.startswith(begun)],
    metavar=f"[{'|'.join(CONTROLLERS)}|{SERIAL}PORT]",
    show_default=True,
    help="The controller that runs: the law in Python (python) or as C (c), or the whole node in "
    "C, here (ecu), on an emulated Cortex-M (arm:m4f, arm:m7) or on a board at a serial port.",
)


def interaction_options(function: Function) -> Function:
    """--pace and --injectable, for the commands that run a plant node."""
    for decorate in (
        click.option(
            "--injectable",
            is_flag=True,
            help="Obey RIG_CONTROL frames: faults injected and cleared, the reference moved, the "
            "run paused; see can-rig inject.  Lockstep only.",
        ),
        click.option(
            "--pace",
            type=float,
            callback=above_zero,
            metavar="X",
            help="Lockstep no faster than X times real time.  [default: as fast as possible]",
        ),
    ):
        function = decorate(function)
    return function


def interaction_of(pace: float | None, injectable: bool, real_time: bool) -> Interaction:
    """The interaction of these options.

    Raises:
        click.UsageError: a run in real time, which cannot be held or paused.
    """
    if real_time and (pace is not None or injectable):
        raise click.UsageError("--realtime and --pace or --injectable: these are of lockstep")
    return Interaction(injectable, pace or 0.0)


log_argument = click.argument("log", type=click.Path(path_type=Path))

channel_option = click.option(
    "--channel", metavar="NAME", help="Only frames of this bus, as the log names it."
)


def window_options(function: Function) -> Function:
    """--from and --to, for every command that reads a log."""
    for name, what in (("to", "before"), ("from", "from")):
        function = click.option(
            f"--{name}",
            f"{name}_s",
            type=float,
            metavar="S",
            help=f"Only frames {what} so many seconds after the start of the recording"
            f"{' on' if name == 'from' else ''}.",
        )(function)
    return function


def out_option(what: str, *, required: bool = False) -> Callable[[Function], Function]:
    """--out, the FILE of ``what``."""
    return click.option(
        "--out",
        type=click.Path(path_type=Path, dir_okay=False),
        required=required,
        metavar="FILE",
        help=what,
    )


force_option = click.option("--force", is_flag=True, help="Replace outputs that exist.")


def json_option(what: str = "The result as one JSON object.") -> Callable[[Function], Function]:
    """--json, which prints ``what``, and nothing else, on standard output."""
    return click.option("--json", "as_json", is_flag=True, callback=_only_json, help=what)


def _only_json(_context: click.Context, _option: click.Parameter, as_json: bool) -> bool:
    if as_json:
        only_json()
    return as_json


def silence_option(default: str) -> Callable[[Function], Function]:
    """--silence, with the ``default`` in the help text."""
    return click.option(
        "--silence",
        "silence_s",
        type=float,
        callback=above_zero,
        metavar="S",
        help=f"Seconds of silence after which the other node counts as gone.  [default: {default}]",
    )
