"""What ``--report`` says of exported files: each tool finds what is wrong, and nothing here."""

from __future__ import annotations

import shutil

import pytest

from can_rig.assessment.resolve import load
from can_rig.export.evidence.coverage import coverage
from can_rig.export.evidence.findings import DEVIATIONS, alarms, findings, misra
from can_rig.export.folder import exported

SCENARIO = load("default", ['design.precision="float32"'])


def needs(tool: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(shutil.which(tool) is None, reason=f"{tool} is not installed")


def test_findings_are_found() -> None:
    files = exported(SCENARIO)
    found = findings({name: text for name, text in files.items() if name.startswith("e2e")})
    assert all(n in (0, "not installed") for n in found.values())
    wrong = {"wrong.c": "int f(void); int f(void) { int unused; return 0; }\n"}
    assert findings(wrong)["gcc"] != 0


@needs("cppcheck")
def test_misra_rules_that_are_broken_have_a_reason() -> None:
    """In files of every kind: the report looks at all of them."""
    chosen = ("e2e.c", "frames.c", "constants.c", "biquad.c", "decision.c")
    files = exported(SCENARIO)
    found = misra({n: text for n, text in files.items() if n.endswith(".h") or n in chosen})
    assert found is not None
    of_the_whole = {"2.5", "8.7"}  # what other files use
    assert {"9.3", "10.4", "12.1"} <= set(found) - of_the_whole <= set(DEVIATIONS)
    wrong = {"wrong.c": "int f(int x) { return x; }\n"}  # without a prototype
    assert misra(wrong) == {"8.4": 1}


@needs("frama-c")
def test_eva_finds_what_may_go_wrong() -> None:
    start = "int main(int c, char **v) { int a[3] = {1, 2, 3}; (void)v; "
    assert alarms({"right.c": start + "return a[(unsigned)c % 3]; }\n"}) == []
    found = alarms({"wrong.c": start + "return a[c] / (c - 1); }\n"})
    assert {line.split(":")[0] for line in found} == {"wrong.c"}
    assert len(found) >= 2


@needs("gcov")
def test_the_trials_run_nearly_all_of_it() -> None:
    found = coverage(SCENARIO)
    assert found.different == 0 < found.compared
    assert found.lines_run >= 0.98 * found.lines > 1000
    assert found.branches_taken >= 0.9 * found.branches > 300
    assert len(found.missed) == found.lines - found.lines_run
