"""The evidence for an exported controller: a record of what tools measure, and its page.

The page shows the record and nothing else. What a missing tool would measure is None in the record.
"""

import hashlib
import html
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from typing import Any, Final

import numpy as np

from can_rig.drawing.html import Code, page, table
from can_rig.export.application import application, exported
from can_rig.export.boards import BOARDS, COMPILER, EMULATOR
from can_rig.export.costs import BOARDS_OF, instructions, instructions_by_file, law_of, sizes
from can_rig.export.findings import COMPILERS, coverage, eva, findings, misra
from can_rig.export.law import law_modules
from can_rig.export.mutants import score
from can_rig.export.provenance import MANIFEST, PROJECT
from can_rig.frames.network import Network
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario
from firmware_model.law.structs import FloatArray

Record = dict[str, Any]

NEEDS: Final = {
    "trials": ("gcc", "gcov"),
    "mutants": ("gcc",),
    "memory": (COMPILER,),
    "instructions": (COMPILER, EMULATOR),
    "misra": ("cppcheck",),
    "eva": ("frama-c",),
}
"""The tools behind each part of the record; each tool in ``COMPILERS`` is measured alone."""

OUTSIDE: Final = "compiler's library"


def evidence(
    scenario: Scenario,
    files: Mapping[str, str],
    runs: Mapping[str, FloatArray],
    campaigns: Mapping[str, Mapping[str, FloatArray]],
    on_step: Callable[[int, int], object] = lambda done, of: None,
) -> Record:
    """What tools measure on a scenario's controller, as numbers, texts, lists and dictionaries.

    Args:
        scenario: the scenario, in the exported precision.
        files: the whole export, text by file name.
        runs: the inputs of runs, from ``frameless.controller_inputs``, by name; the first is the
            scenario's own.
        campaigns: the same of campaigns, of which the worst run is recorded.
        on_step: called with the done and all steps of long measurements, one after another.

    Raises:
        ExportError: a tool refuses.
    """
    node, network = application(scenario), network_of(scenario)
    boards = BOARDS_OF[scenario.design.precision]
    measured: dict[str, Callable[[], Any]] = {
        "trials": lambda: coverage(scenario),
        "mutants": lambda: score(scenario, exported(scenario), on_step),
        "memory": lambda: {each: sizes(law_of(node), each) for each in boards},
        "instructions": lambda: {
            each: _instructions(node, network, each, runs)
            | {"campaigns": _worst_of(node, network, each, campaigns, on_step)}
            for each in boards
        },
        "misra": lambda: misra(files),
        "eva": lambda: eva(files),
    }
    tools = {*COMPILERS.values(), *(tool for needed in NEEDS.values() for tool in needed)}
    return {
        "controller": {
            "scenario": scenario.name,
            "precision": scenario.design.precision,
            "tick_s": scenario.tick_s,
            "generator": f"{PROJECT} {version(PROJECT)}",
            "sha256 of the scenario": _sha256(files[f"{scenario.name}.toml"]),
            "sha256 of the manifest": _sha256(files[MANIFEST]),
        },
        "tools": {tool: _version(tool) for tool in sorted(tools)},
        **{
            part: None if any(map(_missing, NEEDS[part])) else measure()
            for part, measure in measured.items()
        },
        "findings": findings(files),
    }


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _missing(tool: str) -> bool:
    return shutil.which(tool) is None


def _version(tool: str) -> str | None:
    """The first line that a tool says of its version; None: not installed."""
    if _missing(tool):
        return None
    said = subprocess.run([tool, "--version"], capture_output=True, text=True, check=False).stdout
    return next(iter(said.splitlines()), "no version given")


def _instructions(
    node: Mapping[str, str], network: Network, board: str, runs: Mapping[str, FloatArray]
) -> Record:
    """Instructions a tick on a board: of the law, of the whole node, of each part, in each run."""
    own, *_ = runs.values()
    law = law_of(node)
    counts = instructions(law, board, own)
    of_node = {name: instructions(node, board, inputs, network) for name, inputs in runs.items()}
    by_file = instructions_by_file(law, board, own)
    around = of_node[next(iter(runs))].mean() - counts.mean()
    modules, parts = law_modules(), {"frames and their protection": float(around)}
    for file, count in by_file.items():
        path = modules.get(file.removesuffix(".c"), "").split(".")[2:]
        part = ", ".join(path[:-1]).replace("_", " ") or ("law" if file in law else OUTSIDE)
        parts[part] = parts.get(part, 0.0) + count
    return {
        "law": _spread(counts),
        "node": {name: _spread(each) for name, each in of_node.items()},
        "mean of each part": _largest_first(parts),
        "mean of each file of the law": _largest_first(by_file),
    }


def _worst_of(
    node: Mapping[str, str],
    network: Network,
    board: str,
    campaigns: Mapping[str, Mapping[str, FloatArray]],
    on_step: Callable[[int, int], object],
) -> Record:
    """By campaign, the worst tick of the node on a board in all runs."""
    found = {}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for campaign, runs in campaigns.items():
            counted = pool.map(lambda each: instructions(node, board, each, network), runs.values())
            spreads = {}
            for name, counts in zip(runs, counted, strict=True):
                spreads[name] = _spread(counts)
                on_step(len(spreads), len(runs))
            worst = max(spreads, key=lambda name: spreads[name]["worst"])
            of_runs = float(np.median([each["worst"] for each in spreads.values()]))
            found[campaign] = {
                "runs": len(runs), "median of their worst": round(of_runs), "run": worst,
                **spreads[worst],
            }  # fmt: skip
    return found


def _largest_first(counts: Mapping[str, float]) -> Record:
    rounded = {name: round(count, 1) for name, count in counts.items()}
    return dict(sorted(rounded.items(), key=lambda each: -each[1]))


def _spread(counts: FloatArray) -> Record:
    return {
        "median": round(float(np.median(counts))),
        "worst": round(float(counts.max())),
        "tick of the worst": int(np.argmax(counts)),
    }


STYLE: Final = """
h3 { font-size: 1rem; margin: .8rem 0 0; } td:nth-child(3):not(.n) { min-width: 16rem; }
td.bar { width: 18rem; } td.bar i { display: block; height: .8rem; background: var(--blue); }
.good { color: var(--good); } .bad { color: var(--warn); } .none { color: var(--soft); }
@media print { main { max-width: none; } h2 { break-after: avoid; } }
"""


def as_page(record: Record) -> str:
    """The record as an HTML page."""
    about = record["controller"]
    title = f"Evidence: the controller of scenario {about['scenario']} as C"
    return page(
        title,
        [
            f"<h1>{html.escape(title)}</h1>",
            table((), ((name, Code(str(text))) for name, text in about.items())),
            "<h2>Summary</h2>",
            *_summary(record),
            "<h2>Instructions</h2>",
            *_of(record, "instructions", _instructions_tables),
            "<h2>Memory</h2>",
            *_of(record, "memory", lambda of: [_rows_of("of the law", of)]),
            "<h2>C against Python</h2>",
            *_of(record, "trials", _trials),
            "<h2>Mutants of the law</h2>",
            *_of(record, "mutants", _mutants),
            "<h2>MISRA C:2012: deviations</h2>",
            *_of(record, "misra", _misra_table),
            "<h2>Other findings</h2>",
            _of_tools("findings", record["findings"]),
            *_of(record, "eva", lambda alarms: [table(("alarm of Frama-C Eva",), zip(alarms))]),
            "<h2>Tools</h2>",
            _of_tools("version", record["tools"]),
        ],
        STYLE,
    )


def _of(record: Record, part: str, shown: Callable[[Any], list[str]]) -> list[str]:
    """A part of the record, or which tools it lacks."""
    if record[part] is not None:
        return shown(record[part])
    lacking = ", ".join(tool for tool in NEEDS[part] if record["tools"][tool] is None)
    return [f'<p class="none">Not measured: {lacking} is not installed.</p>']


def _of_tools(what: str, said: Record) -> str:
    rows = ((tool, "not installed" if each is None else each) for tool, each in said.items())
    return table(("tool", what), rows)


def _rows_of(title: str, found: Record) -> str:
    """A row for each record of ``found``, which have the same names."""
    first = next(iter(found.values()))
    return table((title, *first), ((name, *each.values()) for name, each in found.items()))


def _claims(record: Record) -> Iterator[tuple[str, str, bool | None]]:
    """Each claim with its number, and whether the claim holds; None: a number without a claim."""
    if (found := record["trials"]) is not None:
        said = f"{found['different']} of {found['compared']} states of random memory differ"
        yield "C computes as Python, bit by bit", said, found["different"] == 0
        lines = f"{found['lines_run'] / found['lines']:.1%} of the lines"
        yield "run by random memory and frames", lines, None
        said = f"{found['conditions_proven']} of {found['conditions']} conditions"
        yield "MC/DC of these trials", said, None
    if (found := record["mutants"]) is not None:
        said = f"{found['killed']} of {found['sample']}, drawn from {found['possible']}"
        yield "mutants of the law noticed by trials or self-test", said, None
    warned = [n for n in record["findings"].values() if n is not None]
    said = f"{sum(warned)} findings of {len(warned)} tools"
    yield "compilers and analysers", said, not any(warned)
    if (rules := record["misra"]) is not None:
        bare = sum(each["reason"] is None for each in rules)
        places = sum(each["times"] for each in rules)
        said = f"{len(rules)} rules at {places} places, {bare} rules without a reason"
        yield "MISRA C:2012", said, bare == 0
    if (alarms := record["eva"]) is not None:
        yield "Frama-C Eva", f"alarms: {len(alarms)}", not alarms
    for board, of in (record["instructions"] or {}).items():
        every = {**of["node"], **{f"{c}, run {e['run']}": e for c, e in of["campaigns"].items()}}
        most, run = max((each["worst"], run) for run, each in every.items())
        yield f"worst tick of the node, {board}", f"{most} instructions ({run})", None


def _summary(record: Record) -> list[str]:
    mark = {None: ("none", ""), True: ("good", "✓"), False: ("bad", "✗")}
    rows = (
        f'<tr><td class="{mark[good][0]}">{mark[good][1]}</td>'
        f"<td>{html.escape(claim)}</td><td>{html.escape(said)}</td></tr>"
        for claim, said, good in _claims(record)
    )
    return [f"<table>{''.join(rows)}</table>"]


def _instructions_tables(found: Record) -> list[str]:
    parts = []
    for board, of in found.items():
        most = max(of["mean of each part"].values())
        bars = "".join(
            f'<tr><td>{html.escape(part)}</td><td class="n">{count:.0f}</td>'
            f'<td class="bar"><i style="width:{100 * count / most:.1f}%"></i></td></tr>'
            for part, count in of["mean of each part"].items()
        )
        parts += [
            f"<h3>{board}, QEMU's {BOARDS[board].machine}</h3>"
            "<p>Counted in every tick of each run; the law takes the inputs of the scenario.</p>",
            _rows_of("run", {"the law alone": of["law"], **of["node"]}),
            *_campaigns(of["campaigns"]),
            f"<table><tr><th>part of a tick</th><th>mean</th><th></th></tr>{bars}</table>",
            _details(
                "each file of the law",
                table(("file", "mean"), of["mean of each file of the law"].items()),
            ),
        ]
    return parts


def _details(title: str, *shown: str) -> str:
    return f"<details><summary>{title}</summary>{''.join(shown)}</details>"


def _counts(found: Record) -> str:
    numbers = ((name.replace("_", " "), n) for name, n in found.items() if isinstance(n, int))
    return table((), numbers)


def _trials(found: Record) -> list[str]:
    unproven = ((where, Code(what), had) for where, what, had in found["unproven"])
    missed = html.escape(", ".join(found["missed"]))
    return [
        "<p>Random memory and inputs through the law, compared in all bits of the state; random "
        "frames through the node. A condition is proven where it has decided the outcome of its "
        "decision both ways (masking MC/DC).</p>",
        _counts(found),
        _details(
            f"{len(found['unproven'])} conditions not proven",
            table(("where", "condition", "what the trials had"), unproven),
        ),
        _details(f"{len(found['missed'])} lines not run", f"<p><code>{missed}</code></p>"),
    ]


def _campaigns(found: Record) -> list[str]:
    if not found:
        return []
    return [
        "<p>The node in the runs of campaigns; the last columns are of the run with the worst "
        "tick.</p>",
        _rows_of("campaign", found),
    ]


def _mutants(found: Record) -> list[str]:
    survivors = ((where, change, Code(line)) for where, change, line in found["survivors"])
    return [
        "<p>A mutant is the law with one token of its C changed. A random sample is compiled; "
        "mutants with the same object code, or without any, do not count.</p>",
        _counts(found),
        _details(
            f"{len(found['survivors'])} mutants not noticed",
            table(("where", "change", "line"), survivors),
        ),
    ]


def _misra_table(found: list[Record]) -> list[str]:
    rows = (
        (each["rule"], each["times"], each["reason"] or "NO REASON",
         Code(", ".join(f"{file} {n}" for file, n in each["files"].items())))
        for each in found
    )  # fmt: skip
    return [
        "<p>Found by cppcheck's addon in the files that run on a target; no rule is mandatory.</p>",
        table(("rule", "times", "reason", "where"), rows),
    ]
