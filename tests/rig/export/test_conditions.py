"""MC/DC of exported C, compared with its definition on random decisions.

By the definition a condition decides a decision where its other value changes the outcome, for some
values of the conditions that C has not evaluated.
"""

import random
import re
import subprocess
from itertools import product

import pytest

from can_rig.export.compiler import placed, run
from can_rig.export.conditions import Recording

NAMES = "abcd"
ASSIGNMENTS = [*product((0, 1), repeat=len(NAMES))]
FORMS = (
    "if ({}) {{ return 1; }} return 0;", "return ({}) ? 1 : 0;",
    "for (int i = 0; i < 1; i++) {{ while ({}) {{ return 1; }} }} return 0;",
    "if ({}) return 1; else return 0;", "return {};", "const int x = /* && */ {}; return x;",
    "return sum(1, {}, 2);",
)  # fmt: skip


def an_expression(choose: random.Random, names: list[str]) -> str:
    """Each name once."""
    if len(names) == 1:
        form = choose.choice(["{}", "{} > 0", "!{}", "!({} == 0)", "one({}) != 0"])
        return form.format(names[0])
    cut = choose.randrange(1, len(names))
    parts = [an_expression(choose, each) for each in (names[:cut], names[cut:])]
    inside = choose.choice([" && ", " || "]).join(parts)
    return choose.choice([f"!({inside})", f"({inside})", inside, inside, inside])


def in_python(expression: str) -> str:
    """With ``see(name)`` in the place of each name."""
    said = expression.replace("&&", "and").replace("||", "or")
    return re.sub(r"\b([a-d])\b", r"see('\1')", re.sub(r"!(?!=)", " not ", said))


def by_definition(expression: str, given: list[tuple[int, ...]]) -> set[str]:
    """The names that decide both ways."""
    code = compile(in_python(expression).strip(), "", "eval")

    def outcome(values: dict[str, int]) -> tuple[bool, set[str]]:
        evaluated: set[str] = set()

        def see(name: str) -> int:
            evaluated.add(name)
            return values[name]

        return bool(eval(code, {"see": see, "one": int})), evaluated

    decided = set()
    for assignment in given:
        _, evaluated = outcome(dict(zip(NAMES, assignment, strict=True)))
        for others in ASSIGNMENTS:
            values = dict(zip(NAMES, others, strict=True))
            values |= {n: v for n, v in zip(NAMES, assignment, strict=True) if n in evaluated}
            for name in evaluated:
                if outcome(values)[0] != outcome(values | {name: 1 - values[name]})[0]:
                    decided.add((name, values[name]))
    return {name for name, value in decided if (name, 1 - value) in decided}


def test_conditions_are_proven_by_what_decides_both_ways(tmp_path):
    choose = random.Random(3)
    expressions, cases, functions, calls = [], [], [], []
    for number in range(400):
        names = choose.sample(NAMES, choose.randint(1, len(NAMES)))
        expressions.append(an_expression(choose, names))
        bare = expressions[-1] in NAMES  # a decision by its place alone
        cases.append(choose.sample(ASSIGNMENTS, choose.randint(2, 8)))
        body = choose.choice(FORMS[:4] if bare else FORMS).format(expressions[-1])
        functions.append(f"static int f{number}(int a, int b, int c, int d) {{ {body} }}")
        calls += [f"f{number}({', '.join(map(str, each))});" for each in cases[-1]]
    text = "\n".join([
        "#include <stdbool.h>", "static int one(int x) { return x; }",
        "static int sum(int x, int y, int z) { return x + y + z; }",
        *functions, "int main(void) {", *calls, "return 0; }",
    ])  # fmt: skip
    recording = Recording({"decisions.c": text})
    run(["gcc", "-o", "program", *placed(tmp_path, recording.files)], tmp_path)
    subprocess.run([tmp_path / "program"], cwd=tmp_path, check=True)
    found: dict[int, set[str]] = {}
    all_conditions = 0
    seen = recording.seen((tmp_path / "seen").read_bytes())
    for decision, combinations in zip(recording.decisions, seen, strict=True):
        if "i < 1" in decision.texts:  # of the loop around another decision
            continue
        all_conditions += len(decision.texts)
        for place, condition, _ in decision.unproven(combinations):
            (name,) = re.findall(r"\b[a-d]\b", condition)
            found.setdefault(int(place.split(":")[1]) - 4, set()).add(name)
    assert all_conditions == sum(len(re.findall(r"\b[a-d]\b", each)) for each in expressions)
    wrong = {}
    for number, (expression, given) in enumerate(zip(expressions, cases, strict=True)):
        names = {*re.findall(r"\b[a-d]\b", expression)}
        proven = names - found.get(number, set())
        if proven != by_definition(expression, given):
            wrong[expression] = proven, given
    assert wrong == {}
    assert 50 < sum(map(len, found.values())) < all_conditions - 50


@pytest.mark.parametrize(
    ("combinations", "expected"),
    [([], "not evaluated"), ([1], "never true"), ([2], "never false"), ([9, 2], None)],
)
def test_what_was_seen_is_named(combinations, expected):
    (decision,) = Recording(
        {"f.c": "int f(int a, int b)\n{\n    return a > 0 || b > 0;\n}\n"}
    ).decisions
    said = {text: (place, had) for place, text, had in decision.unproven(combinations)}
    if expected is None:  # 9: a false, b true; 2: a true, alone
        assert said == {
            "b > 0": ("f.c:3", "never false"),
            "a > 0": ("f.c:3", "never decides alone"),
        }
    else:
        assert said["a > 0"] == ("f.c:3", expected)
