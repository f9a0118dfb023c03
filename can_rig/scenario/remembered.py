"""A cache for repeated computations from equal settings."""

from collections.abc import Callable, Iterable, Iterator
from functools import wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def remembered(
    most: int, by: Callable[..., Iterable[object]] | None = None
) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Cache the ``most`` recently requested results of a function of hashable settings.

    Callers must not change results. ``by`` returns the values that determine the result, all
    hashable; default: every argument.
    """

    def keeping(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        known: dict[tuple[object, ...], tuple[Result]] = {}

        @wraps(function)
        def asked(*arguments: Arguments.args, **keywords: Arguments.kwargs) -> Result:
            what = (*arguments, *keywords.items()) if by is None else by(*arguments, **keywords)
            key = tuple(what)
            # Another thread may ask at the same time, and a fork leaves a lock locked: no lock.
            found = known.pop(key, None) or (function(*arguments, **keywords),)
            known[key] = found  # now the most recent
            if len(known) > most:
                known.pop(next(iter(known.copy())), None)
            return found[0]

        return asked

    return keeping


def state_of_file(file: str) -> Iterator[object]:
    """Time stamp and size of ``file``, which tell whether the file has changed."""
    path = Path(file)
    if file and path.is_file():
        state = path.stat()
        yield state.st_mtime_ns, state.st_size
