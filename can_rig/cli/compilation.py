"""The control law is compiled once on every machine: who waits for it most of a minute is told."""

from __future__ import annotations

import sys


def announce_compilation() -> None:
    """From here on a note says when it is compiled, if the command has anything to do with it."""
    if "firmware_model.compiled" in sys.modules:
        from firmware_model.compiled import tell_when_compiling  # noqa: PLC0415 (is there already)

        tell_when_compiling(_tell)


def _tell() -> None:
    from can_rig.cli.output import note  # noqa: PLC0415 (hardly ever)

    note("compiling the control law, once for this version on this machine: most of a minute")
