"""How long every test takes, and which tests ``./tools/test`` leaves to ``./tools/test --all``.

``./tools/test --times`` runs all tests with this plugin of pytest, and then this file as a program.
The program writes ``tests/long.txt``: the longest tests, until the rest takes `SHARE` of the time
of all tests. The shortest test of a file stays in the quick tier, and with it the time of what the
tests of the file share.
"""

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

LONG = Path(__file__).with_name("long.txt")
FILE = "CAN_RIG_TEST_TIMES"
SHARE = 0.2
"""Of the time of all tests; a share is nearly the same on a slow and on a fast machine."""


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(
    fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest
) -> Iterator[None]:
    """Note when a shared fixture is made."""
    begun_s = time.perf_counter()
    try:
        return (yield)
    finally:
        if fixturedef.scope != "function":
            MADE_S.append(time.perf_counter() - begun_s)


MADE_S: list[float] = []
"""Time of each shared fixture since the test began; one is made after the other."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Write a line for each test: its own time, and that of the shared fixtures made for it."""
    MADE_S.clear()
    begun_s = time.perf_counter()
    result = yield
    taken_s, made_s = time.perf_counter() - begun_s, sum(MADE_S)
    kind = "vcan" if item.get_closest_marker("vcan") else "tests"
    with Path(os.environ[FILE]).open("a", encoding="utf-8") as file:
        file.write(f"{kind} {taken_s - made_s:.3f} {made_s:.3f} {item.nodeid}\n")
    return result


def long_tests(taken_s: dict[str, float], shared_s: float) -> list[str]:
    """The longest tests, so many that the others take at most ``SHARE`` of the time.

    ``shared_s`` is the time of all shared fixtures, and stays.
    """
    quick_first = sorted(taken_s, key=lambda test: (taken_s[test], test))
    kept = {test.partition("::")[0]: test for test in reversed(quick_first)}.values()
    left_s, chosen = sum(taken_s.values()) + shared_s, []
    most_s = SHARE * left_s
    for test in reversed(quick_first):
        if left_s <= most_s:
            break
        if test not in kept:
            left_s -= taken_s[test]
            chosen.append(test)
    return chosen


def main() -> None:
    """Write the list from the file of times that the plugin has written."""
    taken_s: dict[str, dict[str, float]] = {"tests": {}, "vcan": {}}
    made_s = dict.fromkeys(taken_s, 0.0)
    for line in Path(sys.argv[1]).read_text("utf-8").splitlines():
        kind, own, shared, test = line.split(maxsplit=3)
        taken_s[kind][test] = float(own)
        made_s[kind] += float(shared)
    chosen = [test for kind in taken_s for test in long_tests(taken_s[kind], made_s[kind])]
    LONG.write_text("".join(f"{test}\n" for test in sorted(chosen)), "utf-8")


if __name__ == "__main__":
    main()
