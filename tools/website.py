"""Builds the site: the documentation, a reference of commands and Python, a gallery of scenarios.

A page of the gallery has the picture, the numbers and the interactive report of the scenario's own
run. The site opens from a folder, without network; a broken link or anchor fails the build.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from string import Template
from typing import Final

from latex2mathml.converter import convert
from PIL import Image

import can_rig
from can_rig.results.metrics import rows
from can_rig.results.run_folder import PAGE, REPORT, SUMMARY
from can_rig.scenario import shipped
from can_rig.scenario.loading import load

ROOT: Final = Path(__file__).parents[1]
BUILD: Final = ROOT / "build" / "site"
COPIED: Final = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "LICENSE", "docs", "dbc")
ASSETS: Final = ("iframe-worker.js", "website.css", "website.js")
OUTPUT: Final = "output.png"
TOP: Final = 0.28
"""Share of a run's picture with the output of the plant."""
AT_ONCE: Final = 2
"""Scenarios that run at the same time."""

CODE_OR_MATHS: Final = re.compile(
    r"```math\n(.*?)```|```.*?```|`[^`\n]*`|\$\$(.+?)\$\$|\$([^$]+?)\$", re.DOTALL
)
TAG: Final = re.compile(r"\\tag\{(.*?)\}")
OUTSIDE: Final = re.compile(r'<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)="(?:https?:)?//')
"""An element that a browser fetches from the network."""


def main(names: list[str]) -> None:
    """Build the site with a gallery of these scenarios; without a name, of all shipped ones.

    Raises:
        SystemExit: a scenario is unknown or fails, a link is broken, a page needs the network.
    """
    chosen = {name: path for name, path in shipped().items() if not names or name in names}
    if unknown := set(names) - set(chosen):
        raise SystemExit(f"scenario {min(unknown)}: must be one of {', '.join(shipped())}")
    pages = BUILD / "pages"
    shutil.rmtree(BUILD, ignore_errors=True)
    pages.mkdir(parents=True)
    for name in COPIED:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copyfile
        copy(ROOT / name, pages / name)
    (pages / "assets").mkdir()
    for name in ASSETS:
        shutil.copyfile(ROOT / "tools" / name, pages / "assets" / name)
    for page in pages.rglob("*.md"):
        page.write_text(with_mathml(page.read_text("utf-8")), "utf-8")
    write_reference(pages / "reference")
    write_gallery(pages / "gallery", chosen)
    decisions = sorted((pages / "docs" / "decisions").glob("*.md"))
    words = {
        "SITE": str(BUILD / "site"),
        "ROOT": str(ROOT),
        "GALLERY": "\n".join(f"      - gallery/{name}.md" for name in chosen),
        "DECISIONS": "\n".join(
            f"          - docs/decisions/{path.name}" for path in decisions if path.stem != "README"
        ),
    }
    config = Template((ROOT / "tools" / "website.yml").read_text("utf-8"))
    (BUILD / "mkdocs.yml").write_text(config.substitute(words), "utf-8")
    _run("mkdocs", "build", "--strict", "--config-file", BUILD / "mkdocs.yml")
    for page in (BUILD / "site").rglob("*.html"):
        if fetched := OUTSIDE.search(page.read_text("utf-8")):
            raise SystemExit(f"{page}: needs the network: {fetched[0]}")
    print(f"site in {BUILD / 'site' / 'index.html'}")


def _run(module: str, *words: object) -> None:
    """Run a module of this Python, and end with it where it fails."""
    command = [sys.executable, "-m", module, *map(str, words)]
    drawn = os.environ | {"CAN_RIG_NO_REPORT": "0"}  # the gallery shows reports
    done = subprocess.run(command, check=False, cwd=ROOT, capture_output=True, text=True, env=drawn)
    if done.returncode:
        raise SystemExit(f"{done.stdout}{done.stderr}error: {module} {words[0]} {words[1]} failed")


def with_mathml(text: str) -> str:
    """A page whose formulas between dollars are MathML, which browsers draw without a script."""

    def formula(found: re.Match[str]) -> str:
        fenced, block, inline = found.groups()
        written = fenced or block or inline
        if written is None:
            return found[0]
        tag = TAG.search(written)
        drawn = convert(TAG.sub("", written).strip(), display="inline" if inline else "block")
        drawn = drawn.replace("\n", " ")
        if inline:
            return f"<span>{drawn}</span>"
        number = f"<span>({tag[1]})</span>" if tag else ""
        return f'<div class="formula">{drawn}{number}</div>\n'

    return CODE_OR_MATHS.sub(formula, text)


def write_reference(folder: Path) -> None:
    """The pages of commands and of Python; mkdocs fills them from the code."""
    folder.mkdir()
    commands = "::: mkdocs-click\n    :module: can_rig.cli.main\n    :command: main\n"
    options = "    :prog_name: can-rig\n    :depth: 1\n"
    (folder / "commands.md").write_text(f"# Commands\n\n{commands}{options}", "utf-8")
    hint = "`import can_rig` offers these names; [from Python](../docs/python.md) has examples.\n"
    parts = ["# Python\n", hint]
    for name in can_rig.__all__:
        of = getattr(can_rig, name)
        parts.append(f"::: {of.__module__}.{of.__qualname__}\n")
    parts.append("::: can_rig.errors\n")
    (folder / "python.md").write_text("\n".join(parts), "utf-8")


def write_gallery(folder: Path, chosen: dict[str, Path]) -> None:
    """A page for each scenario, from a run of the scenario."""
    folder.mkdir()
    with ThreadPoolExecutor(AT_ONCE) as pool:
        described = list(pool.map(_page, [folder] * len(chosen), chosen, chosen.values()))
    cells = [
        f"| [![{name}]({name}/{OUTPUT}){{ width=420 }}]({name}.md) | [{name}]({name}.md): {words} |"
        for name, words in zip(chosen, described, strict=True)
    ]
    head = ["# Gallery\n\nEach shipped scenario with its own run.\n", "| output | what it shows |"]
    (folder / "index.md").write_text("\n".join([*head, "|---|---|", *cells, ""]), "utf-8")


def _page(folder: Path, name: str, path: Path) -> str:
    """Run a scenario, write its page, and return its description."""
    run = folder / name
    _run("can_rig", "run", name, "--in-process", "--out", run)
    metrics = json.loads((run / SUMMARY).read_text("utf-8"))["metrics"]
    text = path.read_text("utf-8")
    description = str(tomllib.loads(text)["description"])
    numbers = [
        f"| {label.strip().replace('|', '&#124;')} | {value} |"
        for label, value in rows(metrics, load(name).plant)
    ]
    parts = [
        f"# {name}",
        f"{description}.".replace("..", "."),
        f"[The run to zoom and play]({name}/{PAGE}), with all metrics and settings.",
        f"![Signals of the run {name}]({name}/{REPORT})",
        "\n".join(["| measured in this run | value |", "|---|---|", *numbers]),
        f"```sh\ncan-rig run {name}\n```",
        f"```toml\n{text}```",
    ]
    (folder / f"{name}.md").write_text("\n\n".join(parts) + "\n", "utf-8")
    with Image.open(run / REPORT) as picture:
        picture.crop((0, 0, picture.width, round(TOP * picture.height))).save(run / OUTPUT)
    for file in run.iterdir():
        if file.name not in {REPORT, PAGE, OUTPUT}:
            file.unlink()
    return description


if __name__ == "__main__":
    main(sys.argv[1:])
