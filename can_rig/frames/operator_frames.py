"""The frames of ``dbc/control.dbc``, which command a run from outside."""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Final, Literal, NamedTuple, cast

from can import Message
from cantools.database.can import Message as DbcMessage
from e2e.p01 import e2e_p01_check, e2e_p01_protect

from can_rig.errors import DbcError
from can_rig.frames.codec import COUNTERS, FRAME_BYTES
from can_rig.frames.databases import attribute, load_dbc, shipped_dbc

DBC: Final = "control.dbc"
SEQUENCES: Final = 255
"""A multiple of the alive counter's 15, so that the sequence determines the counter."""

ALL: Final = "all"
"""Means every place."""
WORLD: Final = "world"
"""The place of every disturbance."""
CLEARS: Final = {"CLEAR_ALL": ALL, "CLEAR_WORLD": WORLD}
"""The frame's actions of a ``CLEAR`` of what no ``Place`` names."""
OF_FAULTS: Final = ("actuator-", "sensor-", "frames-")
"""How the kind of a fault begins; every other kind is a disturbance's."""

PROTECTION: Final = ("Checksum", "AliveCounter")
"""The first signals of a protected frame."""

SHORTEST_S: Final = 0.1
LONGEST_S: Final = 25.5
"""Longest time of a fault with a set end."""

Action = Literal["INJECT", "CLEAR", "MOVE_REFERENCE", "PACE", "PAUSE", "STEP"]


class Command(NamedTuple):
    """What one ``RIG_CONTROL`` asks for; see the DBC."""

    action: Action
    kind: str | None = None
    """Of a fault or a disturbance."""
    place: str = ALL
    """The place of the fault, ``WORLD`` for a disturbance, or the place to clear."""
    value: float | None = None
    duration_s: float | None = None
    """None: until cleared."""


class State(NamedTuple):
    """What one ``RIG_STATE`` says; see the DBC."""

    injectable: bool
    paused: bool
    next_sequence: int
    last_checksum: int
    refused: int
    pace: float


def value_limits() -> tuple[float, float]:
    """The step of a command's number, and the largest."""
    value = _message("RIG_CONTROL").get_signal_by_name("Value")
    return float(value.scale), float(value.maximum or 0)


@cache
def _message(name: str) -> DbcMessage:
    path = shipped_dbc(DBC)
    for message in load_dbc(path).messages:
        if message.name == name:
            return message
    raise DbcError(f"{path}: has no message {name}; it must have one")


class Identifiers(NamedTuple):
    """Of the five messages."""

    control: int
    state: int
    applied: int
    taken: int
    motion: int


@cache
def identifiers() -> Identifiers:
    """Those of the DBC."""
    return Identifiers(*(_message(f"RIG_{each.upper()}").frame_id for each in Identifiers._fields))


def kinds() -> tuple[str, ...]:
    """The injectable faults and disturbances, by a scenario's words."""
    return tuple(str(word) for word in _choices("Kind").values())


def places() -> tuple[str, ...]:
    """What can fail: both channels, the sensor of D*, the further sensors; and ``WORLD``."""
    return (*_choices("Place").values(), WORLD)


@cache
def _choices(signal: str) -> dict[int, str]:
    found: Mapping[int, object] = _message("RIG_CONTROL").get_signal_by_name(signal).choices or {}
    return {int(number): str(word) for number, word in found.items()}


def command_message(command: Command, sequence: int) -> Message:
    """The frame of ``command``; ``sequence`` is the last ``NextSequence``; values saturate."""
    return _command_message("RIG_CONTROL", command, sequence)


def taken_message(command: Command, sequence: int) -> Message:
    """The plant node's confirmation frame for ``command``."""
    return _command_message("RIG_TAKEN", command, sequence)


def read_command(message: Message, sequence: int) -> Command | None:
    """The command in a ``RIG_CONTROL``; None if damaged or numbered other than ``sequence``."""
    numbered = _read_command("RIG_CONTROL", message)
    return None if numbered is None or sequence != numbered[0] else numbered[1]


def read_taken(message: Message) -> tuple[int, Command] | None:
    """Number and content of a ``RIG_TAKEN``; None if it is damaged."""
    return _read_command("RIG_TAKEN", message)


def _command_message(name: str, command: Command, sequence: int) -> Message:
    value = _message("RIG_CONTROL").get_signal_by_name("Value")
    low, high = float(value.minimum or 0), float(value.maximum or 0)
    clears = {place: action for action, place in CLEARS.items()}
    wide = clears.get(command.place, "") if command.action == "CLEAR" else ""
    data: dict[str, float | str] = {
        "Action": wide or command.action,
        "Sequence": sequence,
        "Kind": command.kind or 0,
        "Place": 0 if command.place in clears else command.place,
        "HasValue": command.value is not None,
        "Duration": 0.0
        if command.duration_s is None
        else min(max(command.duration_s, SHORTEST_S), LONGEST_S),
        "Value": min(max(command.value or 0.0, low), high),
    }
    return protected(_message(name), data, sequence % COUNTERS)


def _read_command(name: str, message: Message) -> tuple[int, Command] | None:
    said = intact(_message(name), message)
    if said is None:
        return None
    sequence = int(said["Sequence"])
    if said["AliveCounter"] != sequence % COUNTERS:
        return None
    action, kind, place = (str(said[name]) for name in ("Action", "Kind", "Place"))
    if action not in _choices("Action").values():
        return None
    if action in CLEARS:
        action, place = "CLEAR", CLEARS[action]
    elif action == "INJECT" and not kind.startswith(OF_FAULTS):
        place = WORLD
    elif action not in {"INJECT", "CLEAR"}:
        place = ALL
    injects = action == "INJECT"
    if injects != (kind in kinds()):
        return None
    command = Command(
        cast(Action, action),
        kind if injects else None,
        place,
        float(said["Value"]) if said["HasValue"] else None,
        float(said["Duration"]) or None,
    )
    return sequence, command


def state_message(state: State, counter: int) -> Message:
    """The frame of ``state``; values saturate."""
    return protected(_message("RIG_STATE"), _saturated("RIG_STATE", state), counter % COUNTERS)


def read_state(message: Message) -> State | None:
    """What a ``RIG_STATE`` says; None if it is damaged."""
    said = intact(_message("RIG_STATE"), message)
    if said is None:
        return None
    _, _, injectable, paused, number, checksum, refused, pace = map(float, said.values())
    return State(bool(injectable), bool(paused), int(number), int(checksum), int(refused), pace)


def applied_message(applied_1: float, applied_2: float) -> Message:
    """The frame of both actuators' applied values; they saturate."""
    return _plain("RIG_APPLIED", (applied_1, applied_2))


def read_applied(message: Message) -> tuple[float, float] | None:
    """The applied values of both actuators; None for a wrong length."""
    values = _read_plain("RIG_APPLIED", message)
    return None if values is None else (values[0], values[1])


class Motion(NamedTuple):
    """The motion of a car in a ``RIG_MOTION`` frame."""

    yaw_rate_rad_per_s: float
    side_slip_rad: float
    steering_angle_rad: float
    speed_mps: float


def motion_message(motion: Motion) -> Message:
    """The frame of ``motion``; values saturate."""
    return _plain("RIG_MOTION", motion)


def read_motion(message: Message) -> Motion | None:
    """What a ``RIG_MOTION`` says; None for a wrong length."""
    values = _read_plain("RIG_MOTION", message)
    return None if values is None else Motion(*values)


def _plain(name: str, values: Sequence[float]) -> Message:
    """A frame without protection, of the values of its signals."""
    frame = _message(name)
    data = frame.encode(_saturated(name, values), strict=False)
    return Message(arbitration_id=frame.frame_id, is_extended_id=False, data=data)


def _saturated(name: str, values: Sequence[float]) -> dict[str, float]:
    """The values of a frame's own signals, by name, each within its signal's range."""
    own = [each for each in _message(name).signals if each.name not in PROTECTION]
    return {
        signal.name: min(max(value, float(signal.minimum or 0)), float(signal.maximum or 0))
        for signal, value in zip(own, values, strict=True)
    }


def _read_plain(name: str, message: Message) -> tuple[float, ...] | None:
    if len(message.data) != FRAME_BYTES:
        return None
    said = cast(dict[str, float], _message(name).decode(bytes(message.data)))
    return tuple(float(value) for value in said.values())


def protected(frame: DbcMessage, data: Mapping[str, float | str], counter: int) -> Message:
    """A frame of these signals, with the alive counter and the checksum of E2E profile 1."""
    every = {**dict.fromkeys(PROTECTION, 0), **data}
    content = bytearray(frame.encode(every, strict=False))
    content[1] = (content[1] & 0xF0) | (counter - 1) % COUNTERS  # the library counts on
    e2e_p01_protect(content, _data_id(frame))
    return Message(arbitration_id=frame.frame_id, is_extended_id=False, data=content)


def intact(frame: DbcMessage, message: Message) -> dict[str, Any] | None:
    """The signals in ``message``, one of ``frame``; None for a damaged frame or another kind."""
    if message.is_extended_id or message.is_remote_frame or message.is_error_frame:
        return None
    if len(message.data) != FRAME_BYTES or not e2e_p01_check(message.data, _data_id(frame)):
        return None
    return cast(dict[str, Any], frame.decode(bytes(message.data)))


def _data_id(frame: DbcMessage) -> int:
    found = attribute(frame, "E2EDataId")
    if not isinstance(found, int):
        raise DbcError(f"{shipped_dbc(DBC)}: message {frame.name}: E2EDataId must be set")
    return found
