"""``can-rig``: the commands by name, each imported on its first call."""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any, Final, NoReturn

import click
from click.shell_completion import CompletionItem

from can_rig.cli.startup import LOST_INTERRUPT, announce_compilation, collect_again, raise_again
from can_rig.errors import INTERRUPTED, UNREAD, RigError

COMMANDS: Final = {
    "run": ("run", "Run both nodes through SCENARIO and write the run folder."),
    "campaign": ("campaign", "Run thousands of variants of a scenario, and report."),
    "plant": ("nodes:plant", "Run the plant node: the simulated car."),
    "controller": ("nodes:controller_node", "Run the controller node: the firmware."),
    "inject": ("inject", "Inject or clear a fault in a running simulation, or pause it."),
    "panel": ("panel", "Watch and control a run in a browser."),
    "scenarios": ("scenarios", "List the scenarios that come with the package."),
    "check": ("check", "Check whether SCENARIO's loop is stable, and by which margins."),
    "bus": ("bus", "Compute worst-case arrival times of the frames, and the latency."),
    "tune": ("tune", "Choose the tuning with the least peak after a loss of the torque."),
    "export": ("export", "Write SCENARIO's controller as C99."),
    "figures": ("figures", "Draw the thesis's figures: firmware over continuous loop."),
    "decode": ("decode", "Decode LOG through a DBC into tables."),
    "convert": ("convert", "Write LOG in another format."),
    "stats": ("stats", "Summarise LOG: identifiers, rates, jitter, gaps, bus load."),
    "replay": ("replay", "Feed LOG to today's controller, and compare the answers."),
    "plot": ("plot", "Draw SIGNALs of LOG."),
    "view": ("view", "Show a run or LOG in a browser: every signal, the plant in motion."),
    "film": ("film", "Draw RUN as a film: the car on its lane, or another plant."),
    "diff": ("diff", "Compare two runs, signal by signal."),
    "compare": ("compare", "Compare several controllers in the same cases."),
}
"""Name → module, where ``command`` or the name after the colon is the command, and the line of
``--help``."""


class Commands(click.Group):
    """Imports a command on its first call; prints the rig's own errors as one line."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names of the commands, in the usual order of work."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command ``cmd_name``, imported."""
        if cmd_name not in COMMANDS:
            return None
        module, _, name = COMMANDS[cmd_name][0].partition(":")
        command: click.Command = getattr(import_module(f"can_rig.cli.{module}"), name or "command")
        collect_again()
        raise_again()
        announce_compilation()
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write names and summaries without importing any command."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in COMMANDS.items()])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Names and lines for a shell, without importing a command."""
        options = click.Command.shell_complete(self, ctx, incomplete)
        found = {name: line for name, (_, line) in COMMANDS.items() if name.startswith(incomplete)}
        return [*(CompletionItem(name, help=line) for name, line in found.items()), *options]

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; bad input never reaches the user as a traceback."""
        try:
            with _usage_on_one_line():
                return super().invoke(ctx)
        except RigError as error:
            _refuse(str(error), error.exit_status)
        except UnicodeEncodeError as error:  # bytes of a file name
            parts = re.finditer(r"[^\r\n<>]+", error.object)  # a whole page may have the name
            name = next(part[0] for part in parts if part.end() > error.start)
            _refuse(f"{name.strip('; ')}: must be a name in UTF-8", 2)
        except BrokenPipeError:  # click would end with 1, a command's no
            sys.stdout = None
            sys.exit(UNREAD)
        except KeyboardInterrupt:  # where no command has taken the signal for a wish to stop
            sys.exit(INTERRUPTED)
        except Exception:
            if not LOST_INTERRUPT.is_set():  # numba fails where a Ctrl-C ends a callback of LLVM
                raise
            sys.exit(INTERRUPTED)

    def make_context(self, *arguments: Any, **keywords: Any) -> click.Context:
        """The context; reports bad options of ``can-rig`` itself on one line, too."""
        with _usage_on_one_line():
            return super().make_context(*arguments, **keywords)


@contextmanager
def _usage_on_one_line() -> Iterator[None]:
    """What click says on four lines; ``can-rig`` alone shows its help."""
    try:
        yield
    except click.exceptions.NoArgsIsHelpError:
        raise
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "can-rig"
        message = " ".join(error.format_message().split())
        _refuse(f"{message} (see {command} --help)", error.exit_code)


def _refuse(text: str, exit_status: int) -> NoReturn:
    from can_rig.cli.output import complain  # noqa: PLC0415 (rich is not needed for --help)

    complain(text)
    sys.exit(exit_status)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="fault-tolerant-steering", prog_name="can-rig")
@click.option("-v", "--verbose", is_flag=True, help="Show what python-can logs, on standard error.")
def main(verbose: bool) -> None:
    """A fault-tolerant steering controller and a simulated car, over CAN.

    SCENARIO is a name of `can-rig scenarios` or a TOML file. Without SCENARIO a command takes
    `default`; `figures` draws the thesis.

    Exit status: 0 done, 1 the answer is no, 2 bad input, 3 a node or the bus fell silent,
    130 stopped by Ctrl-C.
    """
    if verbose:
        import logging  # noqa: PLC0415 (not needed for --help)

        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
        logger = logging.getLogger("can")
        logger.addHandler(handler)  # its own, which is heard while a bus is being opened too
        logger.setLevel(logging.DEBUG)
