"""The part of a recording that --from and --to name."""

from __future__ import annotations

from typing import Final

import click

from can_rig.logs.frames import NS_PER_S
from can_rig.logs.log import ALL, Window

_MOST_S: Final = 9e9


def window_of(from_s: float | None, to_s: float | None) -> Window:
    """The part of a recording between --from and --to.

    Raises:
        click.UsageError: it is none.
    """
    begin_ns, end_ns = (
        default if value is None else round(value * NS_PER_S) if abs(value) < _MOST_S else None
        for value, default in ((from_s, ALL.begin_ns), (to_s, ALL.end_ns))
    )
    if begin_ns is None or end_ns is None or begin_ns >= end_ns:
        raise click.UsageError(f"--from {from_s} --to {to_s}: must be seconds, the first smaller")
    return Window(begin_ns, end_ns)
