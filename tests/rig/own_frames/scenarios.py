"""Scenarios on databases that are not the rig's."""

from pathlib import Path

MOTOROLA = Path(__file__).with_name("motorola.dbc")
SIGNALS = {
    "reference": "VMC_Request.YawRefAcc", "feedback": "ESP_Motion.DStarMeas",
    "command_1": "EPS_Command.MotorTorque", "command_2": "DRV_Command.ForceDiff",
    "fault_estimate": "EPS_Status.Estimate", "mode": "EPS_Status.State",
    "fault_state": "EPS_Status.Fault",
}  # fmt: skip
FD_SIGNALS = {
    "reference": "M1.Value", "feedback": "M2.Value", "command_1": "M3.Value",
    "command_2": "M4.Value", "fault_estimate": "M5.Value", "mode": "M5.Mode",
    "fault_state": "M5.Fault",
}  # fmt: skip
ESP12 = """
BO_ 1310 ESP12: 8 VMC
 SG_ YAW_RATE : 40|13@1+ (0.01,-40.95) [-40.95|40.96] "deg/s" EPS
 SG_ LAT_ACCEL : 24|11@1+ (0.01,-10.23) [-10.23|10.24] "m/s^2" EPS
 SG_ Count : 0|16@1+ (1,0) [0|65535] "" EPS
"""
"""Yaw rate and lateral acceleration in one message, as in a car."""
CALM = {"noise": 0.0, "resolution": 0.0, "corner_hz": 0.0}


def options(
    path: Path, signals: dict[str, str], tick: str = "Count", data_ids: dict[str, int] | None = None
) -> list[str]:
    """``--set`` words of a scenario on the database at ``path``."""
    words = [f"network.dbc={path}", *(f"network.signals.{k}={v}" for k, v in signals.items())]
    words += [f"network.data_ids.{role}={number}" for role, number in (data_ids or {}).items()]
    return [*words, f"network.tick={tick}"] if tick else words


FORMATS = ["StandardCAN", "ExtendedCAN", *["reserved"] * 12, "StandardCAN_FD", "ExtendedCAN_FD"]


def database(
    value: str, length: int, first_id: int = 0x300, types: str = "", fd: bool = False
) -> str:
    """A DBC of five messages M1 to M5, each with this value, a counter, and in M5 two codes."""
    identifiers = range(first_id + 1, first_id + 6)
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: A B"]
    for n, identifier in enumerate(identifiers, 1):
        lines.append(f"BO_ {identifier} M{n}: {length} {'A' if n < 3 else 'B'}")
        lines.append(f' SG_ Value : {value} "" A')
        lines.append(' SG_ Count : 16|16@1+ (1,0) [0|65535] "" A')
        if n == 5:
            lines.append(' SG_ Mode : 12|2@1+ (1,0) [0|3] "" A')
            lines.append(' SG_ Fault : 14|2@1+ (1,0) [0|3] "" A')
    if fd:
        words = ",".join(f'"{word}"' for word in FORMATS)
        lines.append(f'BA_DEF_ BO_ "VFrameFormat" ENUM {words};')
        lines.append('BA_DEF_DEF_ "VFrameFormat" "StandardCAN";')
        form = 15 if first_id >> 31 else 14
        lines += [f'BA_ "VFrameFormat" BO_ {each} {form};' for each in identifiers]
    lines += [f"SIG_VALTYPE_ {each} Value : {types};" for each in identifiers if types]
    return "\n".join(lines) + "\n"
