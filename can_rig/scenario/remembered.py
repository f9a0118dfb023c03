"""Results that are computed again and again from the same settings, kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields, is_dataclass
from functools import wraps
from typing import Any, Final, ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

MOST_TEXTS: Final = 256
"""Tables of settings whose text is kept: those of some scenarios."""

_TEXTS: Final[dict[int, tuple[object, str]]] = {}
"""The last tables and their texts by identity, which is theirs alone as long as they are here."""


def remembered(
    most: int, by: Callable[..., Iterable[object]] | None = None
) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Keep those ``most`` results of a function of settings that were asked for last.

    Nobody may change them. Settings are known by their text, which has every key and every digit;
    they need no hash. ``by`` says what the result follows from, where it is not every argument.
    """

    def keeping(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        known: dict[tuple[str, ...], Result] = {}

        @wraps(function)
        def asked(*arguments: Arguments.args, **keywords: Arguments.kwargs) -> Result:
            what = (*arguments, *keywords.items()) if by is None else by(*arguments, **keywords)
            key = tuple(map(text_of, what))
            result = known[key] if key in known else function(*arguments, **keywords)
            known.pop(key, None)
            known[key] = result  # the last that somebody asked for
            if len(known) > most:
                del known[next(iter(known))]
            return result

        return asked

    return keeping


def text_of(settings: Any) -> str:
    """Every key and every digit; of a table that was asked for not long ago, not again.

    What runs of a campaign have in common are the same tables, which are frozen.
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
