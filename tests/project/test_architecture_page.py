"""docs/architecture.md has every room, and no other."""

import re
from pathlib import Path

import pytest

from tests.project.pages import ROOT, table, text_of


def rooms(package: Path) -> set[str]:
    """Every package below ``package``, by its relative path."""
    inits = {path.parent for path in package.rglob("__init__.py")} - {package}
    return {f"{folder.relative_to(package)}/" for folder in inits}


@pytest.mark.parametrize("package", ["firmware_model", "can_rig"])
def test_every_room_is_in_the_table_and_every_row_is_a_room(package):
    rows = table(text_of("docs/architecture.md"), f"`{package}/`")
    listed = [name for cell, *_ in rows for name in re.findall(r"`([\w/]+/)`", cell)]
    assert sorted(listed) == sorted(rooms(ROOT / package))


@pytest.mark.parametrize("package", ["firmware_model", "can_rig"])
def test_every_room_says_what_lives_there(package):
    for room in rooms(ROOT / package):
        assert '"""' in (ROOT / package / room / "__init__.py").read_text("utf-8"), room
