"""What an export says of its origin, each claim followed up."""

import hashlib
import re
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest

import firmware_model
from can_rig.export.application import HEADER, application, exported, identity
from can_rig.export.provenance import MANIFEST
from can_rig.scenario.loading import load
from tests.helpers import succeeded
from tests.rig.export.shared import run

PROJECT = Path(firmware_model.__file__).parents[1]
WRITTEN = {
    "default": [],
    "wltc": ['design.precision="float32"'],
    "pendulum": ["plant.input_2.name='Stütze'"],
}


@pytest.mark.parametrize("name", WRITTEN)
def test_the_scenario_in_the_folder_gives_the_folder_again(name, tmp_path):
    """Also where the scenario reads a drive from a file."""
    settings = [part for each in WRITTEN[name] for part in ("--set", each)]
    first, again = tmp_path / "first", tmp_path / "again"
    for source, out in (([name, *settings], first), ([str(first / f"{name}.toml")], again)):
        succeeded("export", *source, "--out", out)
    assert {each.name: each.read_bytes() for each in first.iterdir()} == {
        each.name: each.read_bytes() for each in again.iterdir()
    }
    assert str(PROJECT) not in "".join(each.read_text("utf-8") for each in first.iterdir())


def test_two_files_of_one_name_both_lie_beside(tmp_path):
    tables = {"drive": "speed_mps\n0,10\n1,20\n", "reference": "reference_mps2\n0,0\n1,1\n"}
    own = tmp_path / "own.toml"
    own.write_text("")
    for table, text in tables.items():
        (tmp_path / table).mkdir()
        (tmp_path / table / "in.csv").write_text(f"time_s,{text}")
        more = f'[{table}]\nfile = "{table}/in.csv"\n'
        own.write_text(own.read_text() + more + 'kind = "csv"\n' * (table == "reference"))
    succeeded("export", own, "--out", tmp_path / "made")
    again = load(str(tmp_path / "made" / "own.toml"), [])
    for table, text in tables.items():
        assert Path(getattr(again, table).file).read_text() == f"time_s,{text}"


def test_the_licence_has_a_line_of_its_own_however_long_the_name(tmp_path):
    long = replace(load("default", []), name="ein langer Name für eine Lenkung im Süden")
    header = exported(long)[HEADER]
    assert header.startswith("/* SPDX-License-Identifier: MIT\n * From can_rig/export/support/")
    assert "SHA-256 of ein langer Name fur eine Lenkung im Suden.toml: " in header


def test_the_manifest_lists_every_file(built, tmp_path):
    files = exported(load("default", []))
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert run("sha256sum", "--check", MANIFEST, cwd=tmp_path).count(": OK") == len(files) - 1
    with (tmp_path / "biquad.c").open("a") as source:
        source.write("\n")
    with pytest.raises(AssertionError, match="WARNING: 1 computed checksum did NOT match"):
        run("sha256sum", "--check", MANIFEST, cwd=tmp_path)


@pytest.mark.parametrize("kind", ["float32", "drive"])
def test_each_file_and_each_function_name_their_origin(kind, built):
    folder = built(kind)
    (scenario,) = folder.glob("*.toml")
    of_scenario = hashlib.sha256(scenario.read_bytes()).hexdigest()
    functions = 0
    for path in [*folder.glob("*.[ch]"), folder / "Makefile", folder / "CMakeLists.txt"]:
        text = path.read_text(encoding="ascii")
        head = text.splitlines()[:4]
        assert head[0].endswith("SPDX-License-Identifier: MIT")
        origin = re.fullmatch(r"[ *#]+From (\S+) by fault-tolerant-steering (\S+)\.", head[1])
        assert origin is not None, path
        assert origin[2] == version("fault-tolerant-steering")
        source = PROJECT / origin[1]
        assert source.is_file()
        assert head[2].endswith(of_scenario)
        found = re.findall(
            r"^/\* (\w+\.py), line (\d+) \*/\n(?:/\*.*?\*/\n)?(.*?)\(", text, flags=re.M | re.S
        )
        if source.suffix == ".py" and path.suffix == ".c" and "firmware_model/law" in origin[1]:
            defined = re.findall(
                r"^(?!/|#| |\}|\{|const|struct \w+ \{).*?\b(\w+)\(", text, flags=re.M
            )
            assert [re.findall(r"\w+", declared)[-1] for *_, declared in found] == defined
        if path.name == "constants.c":
            tables = re.findall(r"^/\* (\w+)\.py, line (\d+) \*/\nconst struct (\w+) ", text, re.M)
            kinds = {"tables": ("layout_table", "def build(")}
            if kind == "drive":
                kinds["schedules"] = ("schedule_constants", "def schedule(")
            assert {module for module, *_ in tables} == {*kinds}
            for module, line, struct in tables:
                assert struct == kinds[module][0]
                lines = source.with_name(f"{module}.py").read_text("utf-8").splitlines()
                assert lines[int(line) - 1].startswith(kinds[module][1])
            continue
        for name, line, declared in found:
            assert name == source.name
            python = source.read_text("utf-8").splitlines()[int(line) - 1]
            function = re.findall(r"\w+", declared)[-1]
            assert python.startswith(f"def {function.removeprefix(f'{source.stem}_')}(")
            functions += 1
    assert functions > 100


def test_comments_are_no_part_of_a_controllers_identity():
    """A moved line of Python makes no other controller; another number does."""
    node = application(load("default", []))
    moved = {name: re.sub(r", line \d+ ", ", line 1 ", text) for name, text in node.items()}
    assert moved != node
    assert identity(moved) == identity(node)
    other = node | {"biquad.c": node["biquad.c"].replace("[i][1] * u -", "[i][1] * u +")}
    assert identity(other) != identity(node)
