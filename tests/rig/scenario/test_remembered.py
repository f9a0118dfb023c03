"""The cache of repeated computations."""

from collections.abc import Callable

import pytest

from can_rig.scenario.remembered import remembered


class Key:
    """Calls ``then`` in its ``at``-th hash from now on, as if another thread came between."""

    at, then = -1, staticmethod(lambda: None)

    def __hash__(self) -> int:
        self.at -= 1
        if self.at == 0:
            self.then()
        return 1


def test_the_most_recent_results_are_kept():
    made = []
    double: Callable[[int], int] = remembered(2)(lambda n: made.append(n) or 2 * n)
    assert [double(n) for n in (1, 2, 1, 3, 1, 2)] == [2, 4, 2, 6, 2, 4]
    assert made == [1, 2, 3, 2]


@pytest.mark.parametrize("at", range(1, 5))
@pytest.mark.parametrize("same", [True, False])
def test_another_thread_may_ask_in_between(at, same):
    name: Callable[[object], str] = remembered(1)(lambda of: type(of).__name__)
    key = Key()
    name(key)
    key.then = lambda: name(key if same else 0.0)  # type: ignore[method-assign,assignment]
    key.at = at
    assert name(key) == "Key"
    assert name(0.0) == "float"
