"""The README is a screen of purpose and use, and the page of the commands is complete."""

import re

import click

from can_rig import errors
from can_rig.cli.main import main
from can_rig.results.run_folder import LOG, REPORT, SIGNALS, SUMMARY
from tests.project.pages import command_lines, table, text_of

README, COMMANDS = text_of("README.md"), text_of("docs/commands.md")


def test_the_two_commands_come_first():
    tools = [line.split()[0] for line in command_lines(README) if line.startswith("./tools/")]
    assert tools == ["./tools/run", "./tools/test"]


def test_it_stays_short():
    assert len(README.encode()) < 4_000


def test_every_command_is_listed_and_every_listed_command_is_there():
    listed = [
        name
        for cell, *_ in table(COMMANDS, "command")
        for name in re.findall(r"can-rig (\w+)", cell)
    ]
    assert sorted(listed) == sorted(main.list_commands(click.Context(main)))


def test_the_exit_statuses_are_those_of_the_errors():
    listed = {int(cell) for cell, *_ in table(COMMANDS, "exit status")}
    kinds: list[type[errors.RigError]] = [errors.RigError, *errors.RigError.__subclasses__()]
    found = {error.exit_status for error in kinds}
    assert listed == found | {0, 1, errors.INTERRUPTED, errors.UNREAD}


def test_the_files_of_a_run_folder_are_named():
    for page in (README, text_of("docs/results.md")):
        for name in (LOG, SIGNALS, SUMMARY, REPORT):
            assert f"`{name}`" in page
