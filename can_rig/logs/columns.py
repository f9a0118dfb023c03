"""Names of the columns of ``signals.csv``, so that no plant of one's own takes one of them."""

from __future__ import annotations

from typing import Final

from firmware_model.target.fault_decision.hypotheses.verdict import HYPOTHESES
from firmware_model.target.status import Verdict

ON_THE_BUS: Final = (
    "time_s",
    "reference_mps2",
    "dstar_mps2",
    "error_mps2",
    "torque_nm",
    "force_difference_n",
    "fault_estimate_mps2",
    "mode",
)
"""What frames carry."""

TRUE_OUTPUT: Final = "true_dstar_mps2"
APPLIED: Final = ("applied_torque_nm", "applied_force_difference_n")
SPEED: Final = "speed_mps"
"""Of the car, where it has a drive."""
VERDICT: Final = "verdict"
EVIDENCE_OF: Final = "evidence_"
EVIDENCE: Final = tuple(EVIDENCE_OF + fault.name.lower() for fault in list(Verdict)[1:HYPOTHESES])
"""Of each hypothesis on whose fault it is, by the number of its verdict, from 1 on."""

TAKEN: Final = (*ON_THE_BUS, TRUE_OUTPUT, *APPLIED, SPEED, VERDICT, *EVIDENCE)
"""What every plant reports, or the frames, or what is worked out from them."""
