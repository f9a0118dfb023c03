"""A driver who changes lanes: the lateral acceleration that a driver with preview requests.

The driver looks at the lane ``preview_s`` ahead, and requests the constant lateral acceleration
from the car's present position and lateral speed to the lane:

    a = 2 (lane(t + T_p) - y - T_p ẏ)/T_p²,   |a| ≤ ``amplitude_mps2``,

The hands follow this acceleration as a lag of first order, ``reaction_s``. The rule is the
single-point preview of Kondo and Ajimine (SAE 680104, 1968), to which MacAdam's optimal preview
(IEEE Trans. SMC 11 (1981) 393) reduces for one point and an obedient car. The car here obeys: y is
the double integral of the reference, so the reference is independent of the loop.
"""

from __future__ import annotations

import numpy as np

from can_rig.scenario.settings import ReferenceSettings
from firmware_model.compiled import compiled
from firmware_model.target.structs import FloatArray


def lane_changes(settings: ReferenceSettings, time_s: FloatArray, tick_s: float) -> FloatArray:
    """The reference of a driver at ``time_s``, spaced by one tick, shape (ticks,), m/s².

    The first of ``lane_changes_s`` leads to the other lane, the second back, alternating.
    """
    changes = np.sort(np.array(settings.lane_changes_s or (), dtype=np.float64))
    changed = np.searchsorted(changes, time_s + settings.preview_s, side="right")
    seen = (changed % 2).astype(np.float64) * settings.lane_m
    return _driven(seen, tick_s, settings.preview_s, settings.reaction_s, settings.amplitude_mps2)


@compiled
def _driven(
    seen: FloatArray, tick_s: float, preview_s: float, reaction_s: float, largest: float
) -> FloatArray:
    """The acceleration at every tick; ``seen`` is the lane's position at the preview point."""
    asked = np.zeros(len(seen))
    y, speed, acceleration = 0.0, 0.0, 0.0
    follows = 1.0 - np.exp(-tick_s / reaction_s)
    for k in range(len(seen)):
        asked[k] = acceleration
        wanted = 2.0 * (seen[k] - y - preview_s * speed) / (preview_s * preview_s)
        wanted = min(max(wanted, -largest), largest)
        y += tick_s * (speed + 0.5 * tick_s * acceleration)
        speed += tick_s * acceleration
        acceleration += follows * (wanted - acceleration)
    return asked
