"""How long every test takes, and which tests ``./tools/test`` leaves to ``./tools/test --all``.

``./tools/test --times`` runs all tests with this plugin of pytest, and then this file as a program.
The program writes ``tests/long.txt``: the longest tests, until the rest takes `SHARE` of the time
of all tests. The shortest test of a file stays in the quick tier.
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
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Write a line for each test."""
    begun_s = time.perf_counter()
    result = yield
    kind = "vcan" if item.get_closest_marker("vcan") else "tests"
    with Path(os.environ[FILE]).open("a", encoding="utf-8") as file:
        file.write(f"{kind} {time.perf_counter() - begun_s:.3f} {item.nodeid}\n")
    return result


def long_tests(taken_s: dict[str, float]) -> list[str]:
    """The longest tests, so many that the others take at most ``SHARE`` of the time."""
    quick_first = sorted(taken_s, key=lambda test: (taken_s[test], test))
    kept = {test.partition("::")[0]: test for test in reversed(quick_first)}.values()
    left_s, chosen = sum(taken_s.values()), []
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
    for line in Path(sys.argv[1]).read_text("utf-8").splitlines():
        kind, seconds, test = line.split(maxsplit=2)
        taken_s[kind][test] = float(seconds)
    chosen = [test for each in taken_s.values() for test in long_tests(each)]
    LONG.write_text("".join(f"{test}\n" for test in sorted(chosen)), "utf-8")


if __name__ == "__main__":
    main()
