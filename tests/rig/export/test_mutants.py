"""Mutants of exported C: each changes one token, and the trials notice what a reader notices."""

import pytest

from can_rig.errors import ExportError
from can_rig.export import mutants as of_c
from can_rig.export.application import exported
from can_rig.export.mutants import Mutant, mutants, score
from can_rig.scenario.loading import load

SCENARIO = load("default", ["duration_s=0.05", 'design.precision="float32"'])

TEXT = """\
/* a + b */
real f(const real *a, real (*s)[2], int32_t n)
{
    const bool x = !(n >= 2) || a[0] * 0.5f > -*a; /* - */
    for (int32_t i = 0; i < n; i++) {
        (*s)[i] += 0.0f;
    }
    return x ? real_min(a[1], 1e-05f) : 7.0f;
}
"""


def test_each_mutant_changes_a_token_of_code():
    """Not declarations, comments, pointers, or the counting of a loop."""
    changes = [
        (TEXT.splitlines()[TEXT.count("\n", 0, each.at)].strip(), each.before, each.after)
        for each in mutants("f.c", TEXT)
    ]
    lines = TEXT.splitlines()
    condition, loop, sum_, last = (lines[at].strip() for at in (3, 4, 5, 7))
    assert changes == [
        ("real f(const real *a, real (*s)[2], int32_t n)", "2", "3"),
        (condition, "!", ""), (condition, ">=", ">"), (condition, ">=", "<"), (condition, "2", "3"),
        (condition, "||", "&&"), (condition, "0", "1"), (condition, "*", "/"),
        (condition, "0.5f", "2.0f * 0.5f"), (condition, ">", ">="), (condition, ">", "<="),
        (condition, "-", ""),
        (loop, "0", "1"), (loop, "<", "<="), (loop, "<", ">="),
        (sum_, "+=", "-="), (sum_, "0.0f", "1.0f"),
        (last, "real_min", "real_max"), (last, "1", "2"), (last, "1e-05f", "2.0f * 1e-05f"),
        (last, "7.0f", "2.0f * 7.0f"),
    ]  # fmt: skip
    for each in mutants("f.c", TEXT):
        assert TEXT[each.at :].startswith(each.before)


def planted(file: str, line: str, before: str, after: str, files: dict[str, str]) -> Mutant:
    at = files[file].index(line)
    return Mutant(file, files[file].index(before, at), before, after)


def test_what_changes_the_law_is_noticed_and_what_does_not_is_not_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(of_c, "SEEDS", range(2))
    files = exported(SCENARIO)
    bench = of_c._Bench(tmp_path, SCENARIO, files)
    step = "s[i][0] += coefficients[i][1] * u"
    cases = [
        (planted("biquad.c", step, "+=", "-=", files), (True, True)),
        (planted("biquad.c", step, "1", "7", files), (True, True)),  # outside the array
        (planted("biquad.c", "i < cascade->n; i++", "i++", "", files), (True, True)),  # hangs
        (planted("biquad.c", step, "1", "1 /* the same */", files), None),
        (planted("biquad.c", step, "*", "is no C", files), None),
        (planted("echoes.c", "quarter", "0.25", "0.75", files), (True, False)),
    ]  # fmt: skip
    monkeypatch.setattr(of_c, "LONGEST_S", 1.0)
    for number, (mutant, expected) in enumerate(cases):
        assert bench.killers(tmp_path / f"case{number}", mutant) == expected, mutant


def test_a_law_that_is_not_pythons_has_no_score(monkeypatch):
    monkeypatch.setattr(of_c, "SEEDS", range(1))
    files = exported(SCENARIO)
    wrong = files["biquad.c"].replace("s[i][0] += ", "s[i][0] -= ")
    with pytest.raises(ExportError, match="differs from Python"):
        score(SCENARIO, files | {"biquad.c": wrong})


def test_the_score_counts_each_mutant_once(monkeypatch):
    monkeypatch.setattr(of_c, "SEEDS", range(1))
    steps: list[tuple[int, int]] = []
    found = score(SCENARIO, exported(SCENARIO), lambda *step: steps.append(step), 4)
    assert steps == [(done + 1, 4) for done in range(4)]
    assert found["sample"] + found["not_counted"] == 4
    assert found["killed"] + len(found["survivors"]) == found["sample"]
    assert max(found["killed_by_trials"], found["killed_by_self_test"]) <= found["killed"]
    assert found["possible"] > 2000
    monkeypatch.setattr(of_c, "MOST_S", 0.0)
    none = score(SCENARIO, exported(SCENARIO), sample=4)
    assert (none["sample"], none["not_counted"], none["killed"], none["survivors"]) == (0, 0, 0, [])
