"""CPU seconds of every test, and which tests ``./tools/test`` leaves to ``./tools/test --all``.

``./tools/test --times`` runs all tests with this plugin of pytest, and then this file as a program.
The program writes ``tests/long.txt``: the costliest tests, until the rest takes `BUDGET_S`. The
cheapest test of a file stays in the quick tier.
"""

import os
import resource
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

LONG = Path(__file__).with_name("long.txt")
FILE = "CAN_RIG_TEST_TIMES"
BUDGET_S = 230.0
BUDGET_IN_GUEST_S = 15.0


def cpu_s() -> float:
    """CPU time of this process and of its finished children [s]."""
    both = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in both)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Write a line for each test."""
    begun_s = cpu_s()
    result = yield
    kind = "vcan" if item.get_closest_marker("vcan") else "tests"
    with Path(os.environ[FILE]).open("a", encoding="utf-8") as file:
        file.write(f"{kind} {cpu_s() - begun_s:.1f} {item.nodeid}\n")
    return result


def long_tests(taken_s: dict[str, float], budget_s: float) -> list[str]:
    """The costliest tests, so many that the others take at most ``budget_s`` together."""
    quick_first = sorted(taken_s, key=lambda test: (taken_s[test], test))
    kept = {test.partition("::")[0]: test for test in reversed(quick_first)}.values()
    left_s, chosen = sum(taken_s.values()), []
    for test in reversed(quick_first):
        if left_s <= budget_s:
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
    chosen = long_tests(taken_s["tests"], BUDGET_S)
    chosen += long_tests(taken_s["vcan"], BUDGET_IN_GUEST_S)
    LONG.write_text("".join(f"{test}\n" for test in sorted(chosen)), "utf-8")


if __name__ == "__main__":
    main()
