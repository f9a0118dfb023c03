"""The record of ``--evidence``: each tool finds planted errors, and none in exported files.

Costs on emulated boards are compared with something known.
"""

import json
import shutil

import numpy as np
import pytest

from can_rig.export import evidence
from can_rig.export.application import HEADER, application, exported, write
from can_rig.export.boards import COMPILER, EMULATOR
from can_rig.export.costs import instructions, instructions_by_file, law_of, sizes
from can_rig.export.evidence import NEEDS
from can_rig.export.findings import (
    COMPILERS,
    MEMORIES,
    SEEDS,
    TICKS,
    alarms,
    coverage,
    findings,
    misra,
)
from can_rig.export.law import law_files
from can_rig.export.provenance import MANIFEST
from can_rig.plant.frameless import controller_inputs
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from firmware_model.law.layout import state_type, table_type
from firmware_model.law.schedule import Constants, State
from firmware_model.law.structs import record_type
from tests.helpers import refused, succeeded
from tests.rig.export.shared import EMULATED

SCENARIO = load("default", ["duration_s=0.05", 'design.precision="float32"'])
DRIVE = load(
    "drive-cycle",
    ["duration_s=0.1", "drive.ramps=[[0.04,8.0],[0.06,8.1]]", "design.speeds_mps=[8.0,8.9]",
     "fault.kind=none", 'design.precision="float32"'],
)  # fmt: skip


def few_files(*of: object) -> dict[str, str]:
    every, kept = exported(SCENARIO), ("crc", "e2e", "default.toml", HEADER, MANIFEST)
    return {name: text for name, text in every.items() if name.startswith(kept)}


def needs(tool: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(shutil.which(tool) is None, reason=f"{tool} is not installed")


# --- findings ------------------------------------------------------------------------------------


def test_findings_are_found():
    assert {*findings(few_files()).values()} <= {0, None}
    wrong = {"wrong.c": "int f(void); int f(void) { int unused; return 0; }\n"}
    assert findings(wrong)["gcc"] == 1


@needs("cppcheck")
def test_misra_rules_that_are_broken_have_a_reason():
    """In files of several kinds: the report looks at all of them."""
    chosen = ("e2e.c", "ecu.c", "frames.c", "constants.c", "biquad.c")
    files = exported(load("cluster"))  # with further sensors
    found = misra({n: text for n, text in files.items() if n.endswith(".h") or n in chosen})
    of_the_whole = {"2.5", "8.7"}  # what other files use
    without = {each["rule"] for each in found if each["reason"] is None}
    assert without <= of_the_whole
    assert {"9.3", "12.1"} <= {each["rule"] for each in found}
    assert all(each["times"] == sum(each["files"].values()) for each in found)
    wrong = {"wrong.c": "int f(int x) { return x; }\n"}  # without a prototype
    expected = {"rule": "8.4", "times": 1, "reason": None, "files": {"wrong.c": 1}}
    assert misra(wrong) == [expected]


@needs("frama-c")
def test_eva_finds_what_may_go_wrong():
    start = "int main(int c, char **v) { int a[3] = {1, 2, 3}; (void)v; "
    assert alarms({"right.c": start + "return a[(unsigned)c % 3]; }\n"}) == []
    found = alarms({"wrong.c": start + "return a[c] / (c - 1); }\n"})
    assert {line.split(":")[0] for line in found} == {"wrong.c"}
    assert len(found) >= 2


@needs("gcov")
def test_the_trials_run_nearly_all_of_it():
    """Also what blends; conditions and lines are those of the exported files."""
    found, files = coverage(DRIVE), exported(DRIVE)
    assert found["different"] == 0
    after_each_change_and_step_and_the_start = 2 * TICKS + 1
    assert found["compared"] == len(SEEDS) * MEMORIES * after_each_change_and_step_and_the_start
    assert found["lines_run"] >= 0.99 * found["lines"] > 1000
    assert len(found["missed"]) == found["lines"] - found["lines_run"]
    assert not {"schedule.c", "ecu.c"} & {line.split(":")[0] for line in found["missed"]}
    assert found["conditions_proven"] >= 0.95 * found["conditions"] > 500
    assert len(found["unproven"]) == found["conditions"] - found["conditions_proven"]
    for place, condition, _ in found["unproven"]:
        file, line = place.split(":")
        below = " ".join(" ".join(files[file].splitlines()[int(line) - 1 :]).split())
        assert condition in below[: len(condition) + 80]
    law = [
        each for each in found["unproven"] if each[0].split(":")[0] in law_files("float32", True)
    ]
    assert len(law) <= 10


SPREAD = {"median": 5555, "worst": 6666, "tick of the worst": 7}
TRIALS = {
    "compared": 1300, "different": 0, "lines": 200, "lines_run": 150, "conditions": 30,
    "conditions_proven": 29, "missed": [], "unproven": [],
}  # fmt: skip
RECORD = {
    "trials": TRIALS | {"missed": ["biquad.c:7"], "unproven": [("crc.c:8", "a < b", "never true")]},
    "mutants": {"possible": 2000, "sample": 300, "killed": 298,
                "survivors": [("biquad.c:9", "+ becomes -", "y = a + b;")]},
    "sizes": {"code_bytes": 1111, "state_bytes": 333333},
    "instructions": {"law": SPREAD, "node": {"as in the scenario": SPREAD},
                     "mean of each part": {"filters": 888888.0},
                     "mean of each file of the law": {"biquad.c": 9999.0}},
    "campaigns": {"faults": {"runs": 70, "median of their worst": 7000, "run": "3, slow",
                             **SPREAD}},
    "misra": [{"rule": "12.1", "times": 3, "reason": "it is known", "files": {"crc.c": 3}}],
    "eva": [],
}  # fmt: skip


@pytest.mark.parametrize(
    ("missing", "lost"),
    [([], set()), ([EMULATOR], {"instructions"}),
     ([COMPILER, "gcov"], {"memory", "instructions", "trials"}), (["gcc"], {"mutants", "trials"}),
     (["cppcheck", "frama-c"], {"misra", "eva"})],
    ids=lambda each: " ".join(each) if isinstance(each, list) else "",
)  # fmt: skip
def test_what_a_missing_tool_would_measure_is_named(missing, lost, tmp_path, monkeypatch):
    """The rest is on the page, whatever else this machine lacks."""
    monkeypatch.setattr(shutil, "which", lambda name: None if name in missing else f"/bin/{name}")
    monkeypatch.setattr(evidence, "_version", lambda tool: None if tool in missing else "1.0")
    monkeypatch.setattr("can_rig.cli.export.exported", few_files)
    monkeypatch.setattr(evidence, "findings", lambda files: dict.fromkeys(COMPILERS, 0))
    for name, answer in (("coverage", "trials"), ("score", "mutants"), ("sizes", "sizes"),
                         ("_instructions", "instructions"), ("_worst_of", "campaigns"),
                         ("misra", "misra"), ("eva", "eva")):  # fmt: skip
        monkeypatch.setattr(evidence, name, lambda *of, answer=answer: RECORD[answer])
    command = ["export", "default", "--set", "duration_s=0.05", "--evidence", "--out"]
    succeeded(*command, tmp_path / "out")
    record = json.loads((tmp_path / "out" / "evidence.json").read_text(encoding="utf-8"))
    shown = (tmp_path / "out" / "evidence.html").read_text(encoding="utf-8")
    assert {part for part in NEEDS if record[part] is None} == lost
    assert {tool for tool, said in record["tools"].items() if said is None} == {*missing}
    for part, number in (("trials", "biquad.c:7"), ("trials", "a &lt; b"),
                         ("mutants", "+ becomes -"), ("instructions", "3, slow"),
                         ("memory", "333333"), ("instructions", "888888"),
                         ("misra", "it is known")):  # fmt: skip
        assert (number in shown) is (part not in lost)
    for part in lost:
        named = ", ".join(tool for tool in NEEDS[part] if tool in missing)
        assert f"Not measured: {named} is not installed." in shown
    assert shown.count("✗") == 0


def test_what_does_not_hold_is_seen_at_once():
    record = {
        "controller": {"scenario": "a<b"}, "tools": dict.fromkeys(("cppcheck", "gcc"), "1.0"),
        "trials": TRIALS | {"different": 2}, "memory": None,
        "instructions": None, "mutants": None, "eva": ["frames.c:7: overflow"],
        "misra": [{"rule": "8.4", "times": 1, "reason": None, "files": {"wrong.c": 1}}],
        "findings": {"gcc": 1, "clang": None},
    }  # fmt: skip
    record["tools"] |= dict.fromkeys((COMPILER, EMULATOR))
    shown = evidence.as_page(record)
    assert shown.count("✗") == 4
    assert "✓" not in shown
    assert "NO REASON" in shown
    assert "a&lt;b" in shown


def test_an_export_without_evidence_removes_older_evidence(tmp_path):
    files = {HEADER: "", "crc.c": ""}
    write(files | {"evidence.json": "{}", "evidence.html": ""}, tmp_path / "out", force=False)
    write(files, tmp_path / "out", force=True)
    assert {each.name for each in (tmp_path / "out").iterdir()} == {*files}


# --- costs ---------------------------------------------------------------------------------------


@EMULATED
def test_costs_are_of_the_law():
    found = sizes(law_of(application(SCENARIO)), "m4f")
    assert 4000 < found["code_bytes"] < 40_000
    assert 50 < found["stack_bytes"] < 4000
    assert found["constant_bytes"] == table_type("float32").itemsize
    assert found["state_bytes"] == state_type("float32").itemsize


@EMULATED
def test_two_counters_count_the_same():
    """The board's timer counts ticks, a plugin of the emulator the instructions of each file."""
    node, inputs = application(SCENARIO), controller_inputs(SCENARIO)
    law = law_of(node)
    law["turn.c"] = f"void turn(void);\nvoid turn(void) {{ {TURNS.format(n='500')} }}\n"
    call = "    controller_step(&controller_table"
    law["firmware.c"] = law["firmware.c"].replace(call, f"    turn();\n{call}")
    law["firmware.h"] += "void turn(void);\n"
    by_file = instructions_by_file(law, "m4f", inputs)
    assert by_file["turn.c"] == pytest.approx(1000, abs=5)
    assert sum(by_file.values()) == pytest.approx(instructions(law, "m4f", inputs).mean(), rel=0.01)
    network = network_of(SCENARIO)
    found = evidence._instructions(node, network, "m4f", {"own": inputs})
    counts = instructions(node, "m4f", inputs, network)
    assert sum(found["mean of each part"].values()) == pytest.approx(counts.mean(), rel=0.01)
    worst = found["node"]["own"]
    assert counts[worst["tick of the worst"]] == counts.max()
    assert worst["worst"] == round(counts.max())


@EMULATED
def test_the_worst_run_of_a_campaign_is_named():
    """Of three runs the one with a fault in its middle; the same numbers as when counted alone."""
    node, network = application(SCENARIO), network_of(SCENARIO)
    quiet = controller_inputs(SCENARIO)
    runs = {"quiet": quiet, "short": quiet[:7], "wild": np.where(quiet == quiet[9], 1e3, quiet)}
    steps: list[tuple[int, int]] = []
    found = evidence._worst_of(
        node, network, "m4f", {"mine": runs}, lambda *step: steps.append(step)
    )["mine"]
    worst = {name: instructions(node, "m4f", each, network).max() for name, each in runs.items()}
    assert found["run"] == max(worst, key=lambda name: worst[name])
    assert found["worst"] == round(max(worst.values()))
    assert found["median of their worst"] == round(sorted(worst.values())[1])
    assert (found["runs"], steps) == (3, [(1, 3), (2, 3), (3, 3)])


def test_a_campaign_must_have_the_exported_controller(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('runs = 3\n[axes]\n"model.mass_kg" = { share = 0.1 }\n', encoding="utf-8")
    command = ["export", "default", "--evidence", "--campaign", str(file), "--out"]
    line = refused(*command, tmp_path / "out")
    assert "campaign mine: run 0: has a controller with other constants" in line
    line = refused("export", "default", "--campaign", "faults", "--out", "x")
    assert "--campaign: must come with --evidence" in line


@EMULATED
def test_costs_of_a_drive_are_of_its_designs_and_of_its_speed():
    """It keeps the table in memory, and a tick with another speed blends it."""
    assert controller_inputs(SCENARIO).shape == (50, 2)
    inputs = controller_inputs(DRIVE)
    speed = np.interp(np.arange(50) * 0.002, [0.04, 0.06], [8.0, 8.1])
    assert np.allclose(inputs[:, 2], speed, atol=1e-7)
    law = law_of(application(DRIVE))
    found, counts = sizes(law, "m4f"), instructions(law, "m4f", inputs)
    table, state = table_type("float32").itemsize, state_type("float32").itemsize
    assert found["constant_bytes"] == table + record_type(Constants, "float32").itemsize
    assert found["state_bytes"] == state + table + record_type(State, "float32").itemsize
    changes = np.flatnonzero(np.diff(inputs[:, 2]))
    assert len(changes) == 10
    assert counts[changes + 1].min() > 10_000 + np.delete(counts, changes + 1).max()


@EMULATED
def test_the_stack_is_that_of_the_deepest_way_through_either():
    of_law = law_of(application(DRIVE))
    large = "    volatile real large[{n}];\n    large[0] = share;\n    const int32_t n = "
    changed = of_law["schedule.c"].replace("    const int32_t n = ", large.format(n=2000))
    deeper = sizes({**of_law, "schedule.c": changed}, "m4f")
    assert 8000 <= deeper["stack_bytes"] < 8600


TURNS = '__asm__ volatile("mov r3, %0\\n1: subs r3, #1\\n bne 1b" ::"r"((int){n}) : "r3", "cc");'
COUNTED = """\
#include "firmware.h"
void firmware_init(struct {memory} *m) {{ (void)m; }}
void firmware_reset(struct {memory} *m, real r) {{ (void)m; (void)r; }}
void firmware_change_speed(struct {memory} *m, real v);
void firmware_change_speed(struct {memory} *m, real v) {{ {speed} (void)m; }}
struct firmware_answer firmware_step(struct {memory} *m, real r, real y)
{{ {step} (void)m; return (struct firmware_answer){{.command_1 = y}}; }}
"""


@EMULATED
@pytest.mark.parametrize("drives", [False, True])
def test_counts_are_exact_to_two_instructions(drives):
    """A loop of two instructions takes 2 n for n turns, in a step and in a change of the speed."""
    scenario, memory = (DRIVE, "firmware_memory") if drives else (SCENARIO, "layout_state")
    files = {name: text for name, text in exported(scenario).items() if name.endswith(".h")}
    files |= {"schedule.c": ""} if drives else {}
    turns = {"speed": TURNS.format(n="v"), "step": TURNS.format(n="r")}
    files["firmware.c"] = COUNTED.format(memory=memory, **turns)
    steps, speeds = np.array([1.0, 101.0, 1.0, 1001.0]), np.array([1.0, 1.0, 3001.0, 501.0])
    inputs = [steps, steps, *([speeds] if drives else [])]
    counts = instructions(files, "m4f", np.column_stack(inputs))
    expected = 2.0 * (steps - 1.0 + (speeds - 1.0 if drives else 0.0))
    assert np.allclose(counts - counts[0], expected, atol=2.0)
    assert counts[0] < 400
