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
    """Keep those ``most`` results of a function of settings that were asked for last.

    Nobody may change them. Settings are known by their text, which has every key and every digit;
    they need no hash.
    """

    def keeping(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        known: dict[str, Result] = {}

        @wraps(function)
        def asked(*arguments: Arguments.args, **keywords: Arguments.kwargs) -> Result:
            key = repr((arguments, keywords))
            result = known[key] if key in known else function(*arguments, **keywords)
            known.pop(key, None)
            known[key] = result  # the last that somebody asked for
            if len(known) > most:
                del known[next(iter(known))]
            return result

        return asked

    return keeping
