"""The tests of a room as pytest runs them on a mutant: in which order, and for how long."""

from __future__ import annotations

import math
import signal
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import pytest
from hypothesis import Phase, settings

OPTIONS: Final = (
    "-x",
    "-q",
    "--tb=no",
    "-p",
    "no:cacheprovider",
    "-m",
    "not vcan and not long",
)
_FORGOTTEN: Final = 0.8  # what each mutant leaves of the count of those before
_SLOWER: Final = 10  # times the usual duration of a test, and then it hangs
_SLOWER_S: Final = 2.0
_WAITS_S: Final = 120.0  # of the clock on the wall: a test that waits without computing hangs
_STARVES: Final = 100  # times its CPU time: on a busy machine a test that computes takes so long


@dataclass
class Tests:
    """The tests of a room, and what is known of them."""

    paths: Sequence[str]
    cpu_s: dict[str, float] = field(default_factory=dict)
    """CPU time of each test on the unchanged code [s], as far as it is known."""
    below_s: float = math.inf
    """Tests that take longer are left out."""
    kills: dict[str, float] = field(default_factory=dict)
    """Number of mutants that each test has noticed first, the last ones above all."""

    def count(self, killer: str | None) -> None:
        """Take in what noticed a mutant: that test is likely to notice its neighbours too."""
        self.kills = {test: _FORGOTTEN * number for test, number in self.kills.items()}
        if killer:
            self.kills[killer] = self.kills.get(killer, 0.0) + 1.0


class Plugin:
    """Within pytest: the module's own tests first, then those that noticed others.

    None may take much longer than usual.
    """

    def __init__(self, tests: Tests, module: str = "") -> None:
        self.tests = tests
        self.module = module
        self.failed: str | None = None
        self.cpu_s: dict[str, float] = {}

    def pytest_sessionstart(self) -> None:
        """Any example that fails will do: the smallest takes hypothesis longer than the tests."""
        shortened = settings(settings.default, phases=(Phase.explicit, Phase.generate))
        settings.register_profile("mutants", parent=shortened)
        settings.load_profile("mutants")

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Choose and order them."""
        cpu_s = self.tests.cpu_s
        items[:] = [i for i in items if cpu_s.get(i.nodeid, 0.0) < self.tests.below_s]
        for item in items:
            waits_s = _WAITS_S + _STARVES * cpu_s.get(item.nodeid, 60.0)
            item.add_marker(pytest.mark.timeout(waits_s))
        self.order(items)

    def order(self, items: list[pytest.Item]) -> None:
        """The quick ones first; files stay together, for the fixtures that their tests share."""
        file_s: dict[str, float] = defaultdict(float)
        for test, test_s in self.tests.cpu_s.items():
            file_s[test.partition("::")[0]] += test_s
        own = f"/test_{self.module}.py"

        def place(item: pytest.Item) -> tuple[bool, float, float, float]:
            name = item.nodeid
            file, test_s = name.partition("::")[0], self.tests.cpu_s.get(name, 0.0)
            kills = self.tests.kills.get(name, 0.0)
            return not (kills or file.endswith(own)), -kills, file_s[file], test_s

        items.sort(key=place)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Bound the CPU time of a test."""
        usual_s = self.tests.cpu_s.get(item.nodeid, 60.0)
        signal.setitimer(signal.ITIMER_PROF, _SLOWER * usual_s + _SLOWER_S)
        begun_s = time.process_time()
        result = yield
        self.cpu_s[item.nodeid] = time.process_time() - begun_s
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the first test that fails."""
        if report.failed:
            self.failed = self.failed or report.nodeid
