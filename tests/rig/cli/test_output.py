"""Tables and pairs in terminals of any width: no cell is cut, no row goes on below another."""

import pytest

from tests.helpers import asked


@pytest.mark.parametrize("width", [30, 60, 80, 200])
def test_check_keeps_headings_and_figures_in_any_width(width, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(width))
    lines = asked("check", "thesis-step").stdout.splitlines()
    for heading in ("healthy", "torque dead", "torque 75%", "torque 50%", "torque 25%"):
        assert sum(heading in line for line in lines[: lines.index(last(lines))]) == 1
    parts = sum(line.startswith("spectral radius ") for line in lines)
    assert parts == sum(line.startswith("u2 / noise ") for line in lines)
    assert (parts == 1) == (width >= 80)
    table = lines[: lines.index(last(lines)) + 1]
    assert len(table) == parts * 11 - 1  # a heading, nine figures, an empty line between
    assert all(len(line) <= width for line in table)
    assert "…" not in "".join(table)


@pytest.mark.parametrize("width", [30, 80, 200])
def test_no_word_of_a_table_is_cut(width, monkeypatch, tmp_path):
    """Long names that differ in their last letter alone."""
    monkeypatch.setenv("COLUMNS", str(width))
    names = [f"{'A_LONG_NAME_' * 10}{letter}" for letter in "AB"]
    texts = [
        f'BO_ {n} {name}: 1 A\n SG_ V : 0|8@1+ (1,0) [0|0] "" A\n' for n, name in enumerate(names)
    ]
    dbc, log = tmp_path / "a.dbc", tmp_path / "a.log"
    dbc.write_text("".join(texts))
    log.write_text("(1.0) can0 000#01\n(1.0) can0 001#01\n(1.0) can0 001#\n")
    for command in ("decode", "stats"):
        said = asked(command, log, "--dbc", dbc).stdout
        assert [name for name in names if name in said] == names
    said = asked("bus", "default").stdout.split()
    assert "CONTROLLER_STATUS" in said and "identifier" in said


def last(lines: list[str]) -> str:
    """The last row of the table's last part."""
    return next(line for line in reversed(lines) if line.startswith("u2 / noise "))


@pytest.mark.parametrize("width", [60, 80, 200])
def test_the_closing_table_keeps_each_metric_on_its_line(width, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(width))
    words = ("--set", "duration_s=0.1", "--set", "fault.at_s=0.05", "--allow-unstable")
    lines = asked("run", "default", "--in-process", *words).stdout.splitlines()
    assert all(len(line) <= width for line in lines)
    (held,) = [line for line in lines if "held by the rear force difference alone" in line]
    assert held.endswith("m/s²")
    assert not [line for line in lines if line.strip() == "alone"]


def test_what_isolates_whose_fault_it_is_is_said(monkeypatch):
    monkeypatch.setenv("COLUMNS", "1000")
    lines = asked("check", "default").stdout.splitlines()
    (said,) = [line for line in lines if "isolation:" in line]
    assert "the evidence tells either actuator, the sensor and another car apart" in said


@pytest.mark.parametrize(
    ("text", "number"), [(".0015", "0.0015"), ("1.", "1"), ("+.5e-3", "0.0005"), ("abc", None)]
)
def test_a_number_that_toml_does_not_know_is_refused_with_one_that_it_knows(text, number):
    done = asked("check", "default", "--set", f"design.tau_s={text}")
    line = f"error: scenario default: design.tau_s = {text!r}: must be a valid number"
    assert done.stderr == line + (f", as {number}\n" if number else "\n")
