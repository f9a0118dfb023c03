"""Reads every log and database below some folders, and compares with python-can and cantools.

Of a log every frame, of a database every signal of a few random frames for each message. What
docs/logs.md explains is counted by its reason; anything else is printed, and the exit status 1.
"""

from __future__ import annotations

import argparse
import logging
import math
import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final

import can
import numpy as np
from cantools.database.can import Message

from can_rig.decoding.decode import Decoder
from can_rig.decoding.message_decoder import MessageColumns
from can_rig.errors import RigError
from can_rig.frames.databases import load_database
from can_rig.logs.frames import CLASSIC_BYTES, EXTENDED, FD_BYTES, Frames
from can_rig.logs.reading import read_log

LOGS: Final = (".asc", ".blf", ".trc", ".log", ".mf4")
DATABASES: Final = (".dbc", ".kcd", ".sym", ".arxml")
FRAMES: Final = 6  # of each message
CLOSE_S: Final = 1e-6

counts: Counter[str] = Counter()


def differs(path: Path, what: str) -> None:
    """Count and print a difference that nothing explains."""
    counts["DIFFERENT"] += 1
    print(f"{path.name}: {what}")


def compare_log(path: Path) -> None:
    """Frame by frame; a log that python-can cannot read is compared with nothing."""
    options = {"relative_timestamp": False} if path.suffix.lower() == ".asc" else {}
    try:
        with can.LogReader(path, **options) as reader:
            theirs = list(reader)
    except Exception as error:
        theirs, reason = [], f"{type(error).__name__}: {error}"
    else:
        reason = ""
    try:
        ours = [message for frames in read_log(path) for message in frames.messages()]
    except RigError as error:
        counts["logs refused"] += 1
        print(f"refused: {error}")
        return
    if reason:
        counts["logs that python-can refuses"] += 1
        print(f"read here alone: {path.name}, {len(ours)} frames ({reason[:80]})")
        return
    counts["logs"] += 1
    for at, (a, b) in enumerate(zip_longest(ours, theirs)):
        if a is None or b is None:
            differs(path, f"{len(ours)} frames, {len(theirs)} by python-can")
            return
        counts["frames"] += 1
        explained = list(unlike(a, b))
        counts.update(reason for _, reason in explained if reason)
        for name, reason in explained:
            if not reason:
                differs(path, f"frame {at}: {name} of {a} against {b}")


def unlike(ours: can.Message, theirs: can.Message) -> Iterator[tuple[str, str]]:
    """What differs in a frame, and why; "" if nothing explains it."""
    special = ours.is_error_frame or ours.is_remote_frame
    classic = not theirs.is_fd and theirs.dlc > CLASSIC_BYTES
    empty = ours.is_fd and ours.dlc == 0
    reasons = {
        "is_remote_frame": "empty frames of CAN FD" if empty else "",
        "is_extended_id": "error frames" if ours.is_error_frame else "",
        "arbitration_id": "error frames" if ours.is_error_frame else "",
        "dlc": "remote frames" if ours.is_remote_frame else "a DLC above 8" if classic else "",
        "data": "remote and error frames" if special else "",
    }
    for flag in ("is_fd", "bitrate_switch", "error_state_indicator"):
        reasons[flag] = "remote frames" if ours.is_remote_frame else ""
    if abs(ours.timestamp - theirs.timestamp) > CLOSE_S:
        yield "timestamp", ""
    for name in ("arbitration_id", "is_extended_id", "is_error_frame", "is_remote_frame", "is_rx",
                 "is_fd", "bitrate_switch", "error_state_indicator", "dlc", "data"):  # fmt: skip
        if getattr(ours, name) != getattr(theirs, name):
            yield name, reasons.get(name, "")


def compare_database(path: Path, random: np.random.Generator) -> None:
    """Every signal of some random frames of each message; bits outside the message are 0."""
    try:
        database = load_database(path, strict=False)
        decoder = Decoder(database)
    except RigError as error:
        counts["databases refused"] += 1
        print(f"refused: {error}")
        return
    counts["databases"] += 1
    outside = {name.rpartition(".")[2] for name in decoder.left_out}
    known = decoder.names()  # of messages that share an identifier, the last one
    for name, one in decoder.messages.items():
        message = one.message
        if message.length > FD_BYTES:
            continue
        if known[message.frame_id, message.is_extended_frame] != name:
            counts["messages that share an identifier"] += 1
            continue
        frames = random_frames(message, random)
        before = decoder.frames
        columns = decoder.decode(frames).get(name)
        rows = {} if columns is None else {int(r) - before: at for at, r in enumerate(columns.row)}
        for at in range(FRAMES):
            try:
                wanted = message.decode(bytes(frames.data[at, : message.length]), False)
            except Exception:  # it has a signal outside, or no signals for the multiplexer's value
                counts["frames that cantools refuses"] += 1
                continue
            if columns is None or at not in rows:
                differs(path, f"a frame of {name} is not decoded")
                continue
            compare_values(path, columns, rows[at], wanted, outside)


def random_frames(message: Message, random: np.random.Generator) -> Frames:
    """As many as `FRAMES`, all of the message's length."""
    data = random.integers(0, 256, (FRAMES, FD_BYTES), dtype=np.uint8)
    data[:, message.length :] = 0
    return Frames(
        np.arange(FRAMES, dtype=np.int64),
        np.full(FRAMES, message.frame_id, np.uint32),
        np.full(FRAMES, EXTENDED * message.is_extended_frame, np.uint8),
        np.zeros(FRAMES, np.uint8),
        np.full(FRAMES, message.length, np.uint8),
        data,
        ("can0",),
    )


def compare_values(
    path: Path, columns: MessageColumns, row: int, wanted: Any, outside: set[str]
) -> None:
    """One row."""
    for signal, value in wanted.items():
        if signal in outside:
            counts["signals outside their messages"] += 1
            continue
        counts["values"] += 1
        found = columns.signals[signal][row]
        both_nan = isinstance(value, float) and math.isnan(value) and math.isnan(found)
        if np.ma.is_masked(found) or not (found == value or both_nan):
            differs(path, f"{columns.name}.{signal}: {found} against {value}")


def main() -> None:
    """Compare, and print how much was compared."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, help="with logs and databases below")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    random = np.random.default_rng(1)
    for path in sorted(path for folder in options.folders for path in folder.rglob("*")):
        if path.suffix.lower() in LOGS:
            compare_log(path)
        elif path.suffix.lower() in DATABASES:
            compare_database(path, random)
    print(", ".join(f"{number} {what}" for what, number in counts.items()))
    sys.exit(bool(counts["DIFFERENT"]))


if __name__ == "__main__":
    main()
