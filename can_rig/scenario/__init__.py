"""A scenario: TOML to settings, settings to design, target, table and reference.

`shipped/` holds the scenarios of the package. It imports `frames` and `firmware_model`.
"""

from pathlib import Path
from typing import Final

SHIPPED: Final = Path(__file__).parent / "shipped"


def shipped() -> dict[str, Path]:
    """Name → file, sorted; stands here because the command line lists names without numpy."""
    files = {path.stem: path for path in SHIPPED.glob("*.toml")}
    return dict(sorted(files.items()))  # by name: "a-b.toml" comes before "a.toml"
