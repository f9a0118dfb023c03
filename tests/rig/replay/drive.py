"""A short drive, what a bare firmware answers to it, and ways to replay and to damage its log."""

import math
import random
from collections import Counter
from pathlib import Path

from can import Message

from can_rig.frames.codec import Transmitter
from can_rig.replaying.gaps import Gap
from can_rig.replaying.replay import OpenLoop
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controller_table
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import Firmware
from tests.helpers import NAMES
from tests.rig.logs.messages import from_messages

TICKS = 400
SETTINGS = (f"duration_s={TICKS / 1000}", "fault.at_s=0.2")
ALL = 5  # frames of a tick
SCENARIO = load("thesis-step", SETTINGS)
NETWORK = network_of(SCENARIO)


def replay(
    frames: list[Message], scenario: Scenario = SCENARIO, chunk: int = 300
) -> tuple[OpenLoop, list[Gap]]:
    loop = OpenLoop(scenario, network_of(scenario))
    loop.run(from_messages(frames[at : at + chunk]) for at in range(0, len(frames), chunk))
    return loop, loop.account.gaps


def listed(gaps: list[Gap]) -> Counter[tuple[int, str, str]]:
    """Every tick of every gap."""
    return Counter(
        (tick, gap.message, gap.what)
        for gap in gaps
        for tick in range(gap.tick, gap.tick + gap.ticks)
    )


def raw(message: Message) -> int:
    """The value on the wire, read without the codec."""
    return int.from_bytes(message.data[4:8], "little", signed=True)


def answers(
    frames: list[Message], scenario: Scenario, deaf: set[int] = frozenset()
) -> list[tuple[int, int, int, int, int, int]]:
    """What a bare ``Firmware`` sends for the frames of a whole log; ``deaf``: ticks it is given
    nothing. Raw commands and d̂, mode, fault state, verdict."""
    firmware = Firmware(controller_table(scenario, NETWORK))
    firmware.reset(0.0)
    sent = []
    for tick in range(len(frames) // ALL):
        r, y = (
            raw(frames[ALL * tick + at]) * codec.lsb for at, codec in enumerate(NETWORK) if at < 2
        )
        one, two, estimate, *codes = firmware.step(
            *((math.nan, math.nan) if tick in deaf else (r, y))
        )
        values = zip((one, two, estimate), list(NETWORK)[2:], strict=True)
        sent.append((*(codec.to_raw(value) for value, codec in values), *codes))
    return sent


def logged(frames: list[Message]) -> list[tuple[int, int, int, int, int, int]]:
    """The same, as a log has it."""
    rows = []
    for tick in range(len(frames) // ALL):
        one, two, status = frames[ALL * tick + 2 : ALL * tick + ALL]
        bits, value = status.data[1], raw(status)
        codes = bits >> 4 & 3, bits >> 6 & 3, value & 15
        rows.append((raw(one), raw(two), value >> 4, *codes))
    return rows


def mangled(
    frames: list[Message], seed: int
) -> tuple[list[Message], Counter[tuple[int, str, str]]]:
    """1 % of the frames dropped, doubled or swapped with the next, and what is wrong then."""
    chance = random.Random(seed)
    every = range(ALL, len(frames) - 2 * ALL)
    chosen: dict[int, str] = {}
    for at in chance.sample(every, len(frames) // 100 + 2):
        if not {at - 1, at, at + 1} & set(chosen):
            chosen[at] = chance.choice(["drop", "double", "swap"])
    out: list[Message] = []
    wrong: Counter[tuple[int, str, str]] = Counter()
    held: Message | None = None
    for at, frame in enumerate(frames):
        tick, role = divmod(at, ALL)
        what = chosen.get(at)
        if what == "drop":
            wrong[tick, NAMES[role], "missing"] += 1
        elif what == "swap":
            held = frame
            wrong[tick, NAMES[role], "late" if role == ALL - 1 else "out of order"] += 1
        else:
            out += [frame, frame] if what == "double" else [frame]
            if what == "double":
                wrong[tick, NAMES[role], "repeated"] += 1
            if held is not None:
                out.append(held)
                held = None
    return out, wrong


def off_by_one_bit(frames: list[Message], tick: int, role: int) -> list[Message]:
    """The log with the last bit of one answer changed, in a frame that is intact."""
    codec, at = list(NETWORK)[role], ALL * tick + role
    record = codec.decode(frames[at].data)
    sender = Transmitter(codec)
    for _ in range(tick):  # so that its alive counter is right
        sender.frame(0.0, 0)
    near = sender.frame(record.value + codec.lsb, tick, *record[2:])
    assert near.data[2:4] == frames[at].data[2:4]
    near.timestamp = frames[at].timestamp
    return [*frames[:at], near, *frames[at + 1 :]]


def write_log_of(frames: list[Message], path: Path) -> None:
    lines = [
        f"({f.timestamp:.6f}) vcan0 {f.arbitration_id:03X}#{f.data.hex().upper()}\n" for f in frames
    ]
    path.write_text("".join(lines))
