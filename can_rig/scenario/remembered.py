"""Results that are computed again and again from the same settings, kept."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def remembered(
    most: int,
) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Keep the last ``most`` results of a function of settings, which nobody may change.

    Settings are known by their text, which has every key and every digit; they need no hash.
    """

    def keeping(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        known: dict[str, Result] = {}

        @wraps(function)
        def asked(*arguments: Arguments.args, **keywords: Arguments.kwargs) -> Result:
            key = repr((arguments, keywords))
            if key not in known:
                result = function(*arguments, **keywords)
                if len(known) >= most:
                    del known[next(iter(known))]
                known[key] = result
            return known[key]

        return asked

    return keeping
