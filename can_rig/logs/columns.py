"""Names of the columns of ``signals.csv``, which a user's plant may not take."""

from typing import Final

from firmware_model.law.status import Verdict

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
"""Columns from the frames."""

TRUE_OUTPUT: Final = "true_dstar_mps2"
APPLIED: Final = ("applied_torque_nm", "applied_force_difference_n")
SECOND_MASS: Final = "second_mass_m"
SPEED: Final = "speed_mps"
"""Speed of the car, if the plant has a drive."""
VERDICT: Final = "verdict"
EVIDENCE_OF: Final = "evidence_"
EVIDENCE: Final = tuple(
    EVIDENCE_OF + fault.name.lower() for fault in list(Verdict)[1:] if fault <= Verdict.ANOTHER_CAR
)
"""Evidence for each fault hypothesis, ordered by the number of the verdict, from 1 on."""

TAKEN: Final = (*ON_THE_BUS, TRUE_OUTPUT, *APPLIED, SPEED, VERDICT, *EVIDENCE)
"""Columns from plants, from frames, and from later computation."""
