"""The tests of the translator translate lines of their own."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.rig.export.lines import Translate, translated


@pytest.fixture
def translate(tmp_path: Path) -> Translate:
    """Translates a function from its text, into a folder."""
    return lambda text: translated(text, tmp_path)
