"""The scenarios that come with the package."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parent / "shipped"


def shipped() -> dict[str, Path]:
    """Name → file, sorted."""
    return {path.stem: path for path in sorted(FOLDER.glob("*.toml"))}
