"""docs/scenario-keys.md: each key of a scenario, and what the page allows."""

import re
from collections.abc import Iterator
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "scenario-keys.md"
ROW = re.compile(r"^\| `(\w+)` \|[^|]*\|[^|]*\| (.*?) \|", re.MULTILINE)
SAME = re.compile(r"^The keys of `\[(.*)\]`\.$", re.MULTILINE)


def keys_of_the_page() -> Iterator[tuple[str, str]]:
    """Each key with its table, and what is allowed; a model has the keys of a plant."""
    rows_of: dict[str, list[tuple[str, str]]] = {}
    for part in PAGE.read_text("utf-8").split("\n## ")[1:]:
        heading = re.match(r"`\[(.*)\]`", part)
        table = heading[1] if heading else ""
        rows = rows_of[table] = ROW.findall(part)
        for other in SAME.findall(part):
            rows += rows_of[other]
        for key, allowed in rows:
            name = f"{table}.{key}".lstrip(".")
            yield name, allowed
            if name.startswith("plant."):
                yield f"model.{name.removeprefix('plant.')}", allowed
