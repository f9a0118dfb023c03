"""The mutants of the exported C: what changes, and that every excuse is of a mutant."""

from __future__ import annotations

import importlib
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

from can_rig.assessment.resolve import load
from can_rig.export.application import application

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.fixture
def sites(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module, imported as the tools do."""
    monkeypatch.syspath_prepend(str(TOOLS))
    return importlib.import_module("mutation_c_sites")


SOURCE = """\
/* a + b */
#define LIMIT 80.0f /* 1 + 1 */
static real f(real x);

real f(real x)
{
    const real y = x * 2.0 + 1.0; /* 3 < 4 */
    if (!(y < LIMIT)) {
        count++;
        return -x;
    }
    return real_min(x, 0.0);
}
"""


def test_each_change_is_there_once(sites: ModuleType) -> None:
    found = [(each.line, each.after) for each in sites.mutants(SOURCE)]
    assert found == [
        (2, "#define LIMIT 160.0f"),
        (7, "const real y = x / 2.0 + 1.0;"),
        (7, "const real y = x * 4.0 + 1.0;"),
        (7, "const real y = x * 2.0 - 1.0;"),
        (7, "const real y = x * 2.0 + 0.0;"),
        (7, "const real y = x * 2.0 + 2.0;"),
        (8, "if ((y < LIMIT)) {"),
        (8, "if (!(y <= LIMIT)) {"),
        (8, "if (!(y >= LIMIT)) {"),
        (9, "count--;"),
        (9, ";"),
        (12, "return real_max(x, 0.0);"),
        (12, "return real_min(x, 1.0);"),
    ]
    for each in sites.mutants(SOURCE):
        changed = zip(SOURCE.splitlines(), each.source.splitlines(), strict=True)
        assert [at + 1 for at, (one, other) in enumerate(changed) if one != other] == [each.line]


def test_every_excuse_is_of_a_mutant_and_has_a_reason(sites: ModuleType) -> None:
    known = {
        f"{name}: {each.before}  →  {each.after}"
        for scenario in ("default", "drive-cycle")
        for name, text in application(load(scenario, [])).items()
        if name.endswith(".c")
        for each in sites.mutants(text)
    }
    entries = tomllib.loads((TOOLS / "mutation_c.toml").read_text("utf-8"))["accepted"]
    for entry in entries:
        assert len(entry["reason"]) > 10
        assert not {*entry["changes"]} - known
