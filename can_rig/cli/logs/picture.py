"""A picture as an output."""

from __future__ import annotations

from pathlib import Path

from can_rig.errors import LogError
from can_rig.files import refuse_existing

SUFFIXES = {".png", ".svg", ".pdf"}
"""Of pictures; matplotlib knows the format by it."""


def refuse_picture(path: Path, force: bool) -> None:
    """Refuse a picture that cannot be one, or exists.

    Raises:
        LogError: the reason.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise LogError(f"{path}: a picture must be FILE.png, FILE.svg or FILE.pdf")
    refuse_existing(path, force, "--out")
