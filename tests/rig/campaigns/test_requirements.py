"""Requirements: the verdict and the margin of an expression, and refused syntax."""

import itertools

import pytest
from hypothesis import example, given, strategies as st

from can_rig.campaigns.requirements import Requirement, least_of
from can_rig.errors import ScenarioError

NAMES = ("a", "b", "yes")
REFUSED = [
    "__import__('os').system('true')", "a.real", "a[0]", "abs(a)", "a ** 2 > 1", "lambda: a",
    "[a]", "'text' == a", "a if b else yes", "(a := 1) > 0", "a in b", "a is None", "f'{a}'",
    "a & b", "a % 2 == 0", "not a + 1", "a + 1", "a, b", "1", "inf > a", "1e999 > a",
    "yes == (a < b)", "await a", "", "a <", "a == None", "...", "-(a < b) > 0", "{a}", "*a",
]  # fmt: skip


@pytest.mark.parametrize("text", REFUSED)
def test_nothing_but_an_expression_over_metrics_is_read(text):
    with pytest.raises(ScenarioError, match=r"^requirements\.some = .*must|no such metric"):
        Requirement("some", text, NAMES)


def test_an_unknown_name_and_too_long_an_expression_are_named():
    with pytest.raises(ScenarioError, match="c: no such metric; there are a, b, yes"):
        Requirement("some", "c > 1", NAMES)
    with pytest.raises(ScenarioError, match="must be at most 500 characters"):
        Requirement("some", "-" * 600 + "a > 1", NAMES)


def expressions() -> st.SearchStrategy[str]:
    """Expressions that Python reads as this module should."""
    numbers = st.recursive(
        st.sampled_from(["a", "b", "0", "2.5", "-a"]),
        lambda part: st.tuples(part, st.sampled_from("+-*/"), part).map(
            lambda t: f"({t[0]} {t[1]} {t[2]})"
        ),
        max_leaves=4,
    )
    compared = st.tuples(numbers, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), numbers)
    truths = st.one_of(
        compared.map(" ".join),
        st.tuples(numbers, numbers, numbers).map(" <= ".join),
        st.just("yes"),
    )
    return st.recursive(
        truths,
        lambda part: st.one_of(
            st.tuples(part, st.sampled_from([" and ", " or "]), part).map(
                lambda t: f"({t[0]}{t[1]}{t[2]})"
            ),
            part.map(lambda text: f"(not {text})"),
        ),
        max_leaves=5,
    )


@given(expressions(), st.floats(-9, 9), st.floats(-9, 9), st.booleans())
@example("a < b", 1.0, 1.0, False)
@example("(not a <= b)", 1.0, 1.0, False)
@example("(a <= (2.5 / a) <= a and yes)", 2.2e-311, 0.0, False)  # 2.5 / a is more than a float has
def test_it_says_what_python_says(text, a, b, yes):
    values = {"a": a, "b": b, "yes": yes}
    margin = Requirement("some", text, NAMES).of(values)
    try:
        expected = bool(eval(text, {"__builtins__": {}}, values))
    except ZeroDivisionError:
        return
    if margin is not None:  # an overflow is no number
        assert margin > 0.0 if expected else margin < 0.0


@pytest.mark.parametrize(("one", "other"), list(itertools.product([True, False, None], repeat=2)))
def test_what_a_run_does_not_have_is_neither_true_nor_false(one, other):
    values = {"a": one, "b": other, "yes": None}
    known = [one, other]
    both = False if False in known else None if None in known else True
    either = True if True in known else None if None in known else False
    margins = {True: 1.0, False: -1.0, None: None}
    assert Requirement("some", "a and b", NAMES).of(values) == margins[both]
    assert Requirement("some", "a or b", NAMES).of(values) == margins[either]
    for text in ("not yes", "yes + a > 1", "a / 0 > 1"):
        assert Requirement("some", text, NAMES).of(values) is None


def test_a_margin_is_in_parts_of_the_bound_and_the_least_counts():
    values = {"a": 0.04, "b": 3.0, "yes": True}
    wanted = {"a <= 0.05": 0.2, "a <= 0.02": -1.0, "b >= 2 and a <= 0.05": 0.2,
              "b >= 4 or a <= 0.05": 0.2, "not b >= 4": 0.25, "yes": 1.0, "b == 3": 1.0,
              "b == 0": -3.0}  # fmt: skip
    found = {text: Requirement("some", text, NAMES).of(values) for text in wanted}
    assert found == pytest.approx(wanted)
    assert least_of([*found.values(), None]) == -3.0
    assert least_of([None]) is None


def test_a_number_that_no_float_holds_is_refused():
    with pytest.raises(ScenarioError, match="must be finite"):
        Requirement("small", f"detection_delay_s <= 1{'0' * 320}", {"detection_delay_s"})
