"""Where each exported file comes from, and the files that repeat and check the export."""

import hashlib
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import tomli_w

from can_rig.errors import ScenarioError
from can_rig.export.c_files import plain
from can_rig.export.law import law_modules
from can_rig.scenario.build import dbc_of
from can_rig.scenario.loading import FILES, written_by
from can_rig.scenario.settings import Scenario

MANIFEST: Final = "manifest.sha256"
"""SHA-256 and name of every other file, as ``sha256sum --check`` reads them."""

PROJECT: Final = "fault-tolerant-steering"


def with_provenance(texts: Mapping[str, str], scenario: Scenario) -> dict[str, str]:
    """The files of an export with their origin, the scenario as a file, and the manifest.

    Exporting the scenario's file again gives the same files.

    Args:
        texts: text by file name.
        scenario: the exported scenario.

    Raises:
        ScenarioError: no file gives the scenario.
    """
    name, inputs = f"{scenario.name}.toml", _scenario_files(scenario)
    at, found = hashlib.sha256(inputs[name].encode()).hexdigest(), dict(inputs)
    origins = _origins(scenario)
    for file, text in texts.items():
        origin = origins.get(file.rpartition(".")[0], f"can_rig/export/support/{file}")
        lines = [
            "SPDX-License-Identifier: MIT",
            f"From {origin} by {PROJECT} {version(PROJECT)}.",
            f"SHA-256 of {name}: {at}",
        ]
        if file.endswith((".c", ".h")):
            head = [f" * {line}" for line in map(plain, lines)]
            found[file] = "\n".join(["/*" + head[0][2:], *head[1:], " */", text])
        else:
            found[file] = "".join(f"# {line}\n" for line in lines) + text
    hashes = (
        f"{hashlib.sha256(as_bytes(found[each])).hexdigest()}  {each}\n" for each in sorted(found)
    )
    return found | {MANIFEST: "".join(hashes)}


def as_bytes(text: str) -> bytes:
    """A file of an export; a scenario's file has the bytes that it had."""
    return text.encode(errors="surrogateescape")


def _origins(scenario: Scenario) -> dict[str, str]:
    """The source of each file that is not handwritten C, by the name without suffix."""
    return {
        **{name: f"{module.replace('.', '/')}.py" for name, module in law_modules().items()},
        "constants": "firmware_model/discretisation/tables.py",
        "network": ("" if scenario.network.dbc else "dbc/") + dbc_of(scenario).name,
        "self_test_data": "can_rig/export/self_test.py",
    }


def _scenario_files(scenario: Scenario) -> dict[str, str]:
    """The scenario as TOML, its CSV files and its database, by file name."""
    values: dict[str, Any] = written_by(scenario)
    found: dict[str, str] = {}
    for table, key, _ in FILES:
        path = Path(str(values.get(table, {}).get(key, "")))
        if path.suffix.lower() == ".csv" or (key == "dbc" and path.name):
            try:
                text = path.read_bytes().decode(errors="surrogateescape")
            except OSError as error:
                raise ScenarioError(
                    f"{table}.{key} = {str(path)!r}: cannot be read: {error}"
                ) from None
            name = path.name if found.get(path.name, text) == text else f"{table}-{path.name}"
            found[name], values[table][key] = text, name
    return {**found, f"{scenario.name}.toml": tomli_w.dumps(values)}
