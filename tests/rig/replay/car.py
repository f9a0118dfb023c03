"""A simulated drive as the log of a car: frames of two buses, jitter, absolute times, a gap."""

import random
from pathlib import Path
from typing import Any

import cantools
import numpy as np
from can import Message

from can_rig.api import run

FOLDER = Path(__file__).parents[3] / "docs" / "car"
CAR = FOLDER / "car.toml"
START_S = 1_763_000_000.0
LOSS_S = 6.0
SPEED_MPS = 10.0
GAP_S = (4.0, 4.4)
"""Without frames of MOTION."""
CHANGES = {
    "duration_s": 10.0,
    "reference.kind": "sine",
    "reference.frequency_rad_per_s": 2.0,
    "fault.at_s": LOSS_S,
}


def recorded(gap_s: tuple[float, float] = GAP_S) -> list[Message]:
    """The frames of the drive, in order."""
    signals = run("chassis-can", CHANGES).signals
    database: Any = cantools.database.load_file(FOLDER / "car.dbc")
    chance = random.Random(5)
    frames: list[Message] = []

    def add(at_s: float, bus: str, name: str, **values: float) -> None:
        message = database.get_message_by_name(name)
        jitter_s = chance.uniform(0.0, 0.0004)
        data = message.encode(values, strict=False)
        frames.append(
            Message(START_S + at_s + jitter_s, message.frame_id, False, channel=bus, data=data)
        )

    yaw = signals["yaw_rate_rad_per_s"].to_numpy()
    lateral = 2.0 * signals["true_dstar_mps2"].to_numpy() - SPEED_MPS * yaw  # (3.8), d = 0.5
    applied = signals["applied_torque_nm"].to_numpy()
    force = signals["applied_force_difference_n"].to_numpy()
    sent = signals["torque_nm"].to_numpy()
    for tick, at_s in enumerate(signals.index):
        if not gap_s[0] <= at_s < gap_s[1]:
            add(
                at_s - 0.0009, "can0", "MOTION",
                YawRate=np.rad2deg(yaw[tick]), LateralAcceleration=lateral[tick] / 9.80665,
            )  # fmt: skip
        if tick % 2 == 0:
            add(at_s - 0.0007, "can0", "WHEELS", Speed=3.6 * SPEED_MPS)
        add(at_s - 0.0006, "can0", "DRIVES", ForceDifference=force[tick])
        add(at_s - 0.0005, "can1", "EPS_STATUS", MotorTorque=applied[tick])
        add(at_s + 0.0095, "can1", "EPS_REQUEST", Torque=sent[tick])
    return sorted(frames, key=lambda frame: frame.timestamp)
