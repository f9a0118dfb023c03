"""What can run as the control law, by the name that a command gives it."""

from __future__ import annotations

from typing import Final

from can_rig.scenario.settings import Scenario
from firmware_model.firmware import PYTHON_LAW, Law

CONTROLLERS: Final = ("python", "c")


def law_of(controller: str, scenario: Scenario) -> Law:
    """The control law as ``controller``, one of ``CONTROLLERS``, runs it.

    Raises:
        ExportError: there is no C compiler, or it refuses.
    """
    if controller == "python":
        return PYTHON_LAW
    from can_rig.export.compiled_law import CompiledLaw  # noqa: PLC0415 (no other run needs it)

    return CompiledLaw(scenario.design.precision)
