"""A note before the control law compiles: most of a minute, once on every machine."""

from __future__ import annotations

import sys


def announce_compilation() -> None:
    """From here on print a note before the control law compiles."""
    if "firmware_model.compiled" in sys.modules:
        from firmware_model.compiled import tell_when_compiling  # noqa: PLC0415 (is there already)

        tell_when_compiling(_tell)


def _tell() -> None:
    from can_rig.cli.output import note  # noqa: PLC0415 (hardly ever)

    note("compiling the control law, once for this version on this machine: most of a minute")
