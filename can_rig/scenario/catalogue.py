"""The scenarios shipped with the package."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parent / "shipped"


def shipped() -> dict[str, Path]:
    """Name → file, sorted."""
    files = {path.stem: path for path in FOLDER.glob("*.toml")}
    return dict(sorted(files.items()))  # by name: "a-b.toml" comes before "a.toml"
