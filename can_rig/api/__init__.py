"""The rig from Python, in a notebook or a script: ``import can_rig``.

    run = can_rig.run("default", {"fault.at_s": 5.0})
    run.metrics["dstar_peak_mps2"]
    run.signals["error_mps2"].plot()
    run.save("runs/early-loss")

A scenario is the name of a shipped one, a TOML file, or a ``Scenario``; changes are a mapping of
its keys, as ``--set`` of the command line has them. What the caller can put right is raised as a
``can_rig.errors.RigError`` of one line.

Commands may import it; it imports every room below.
"""

from can_rig.api.calls import (
    RecordedRun,
    Scenario,
    check,
    decode,
    load,
    run,
    scenario,
    tune,
)

__all__ = [
    "RecordedRun",
    "Scenario",
    "check",
    "decode",
    "load",
    "run",
    "scenario",
    "tune",
]
