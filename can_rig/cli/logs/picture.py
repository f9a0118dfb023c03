"""A picture as an output."""

from __future__ import annotations

from pathlib import Path

from can_rig.errors import LogError
from can_rig.files import refuse_existing


def refuse_picture(path: Path, force: bool) -> None:
    """Refuse a picture that cannot be one, or exists.

    Raises:
        LogError: the reason.
    """
    if path.suffix.lower() != ".png":
        raise LogError(f"{path}: a picture must be FILE.png")
    refuse_existing(path, force, "--out")
