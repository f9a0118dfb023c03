"""A cache for repeated computations from equal settings."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields, is_dataclass
from functools import wraps
from typing import Any, Final, ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

MOST_TEXTS: Final = 256
"""Limit of the cache of settings texts: the tables of several scenarios."""

_TEXTS: Final[dict[int, tuple[object, str]]] = {}
"""The last tables and their texts by identity; a kept table keeps its identity unique."""


def remembered(
    most: int, by: Callable[..., Iterable[object]] | None = None
) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Cache the ``most`` recently requested results of a function of settings.

    Callers must not change results. The key is the settings' text, with every key and every digit;
    settings need no hash. ``by`` returns the arguments that determine the result; default: every
    argument.
    """

    def keeping(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        known: dict[tuple[str, ...], Result] = {}

        @wraps(function)
        def asked(*arguments: Arguments.args, **keywords: Arguments.kwargs) -> Result:
            what = (*arguments, *keywords.items()) if by is None else by(*arguments, **keywords)
            key = tuple(map(text_of, what))
            result = known[key] if key in known else function(*arguments, **keywords)
            known.pop(key, None)
            known[key] = result  # now the most recent
            if len(known) > most:
                del known[next(iter(known))]
            return result

        return asked

    return keeping


def text_of(settings: Any) -> str:
    """Every key and every digit of the settings, from the cache for a recently used table.

    Runs of a campaign share their common tables, which are frozen.
    """
    kept = _TEXTS.get(id(settings))
    if kept is not None:
        return kept[1]
    if not is_dataclass(settings):
        return repr(settings)
    parts = (text_of(getattr(settings, field.name)) for field in fields(settings))
    text = f"{type(settings).__qualname__}({', '.join(parts)})"
    _TEXTS[id(settings)] = settings, text
    if len(_TEXTS) > MOST_TEXTS:
        del _TEXTS[next(iter(_TEXTS))]
    return text
