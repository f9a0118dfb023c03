"""Reads damaged logs and databases, and replays damaged drives.

Each must be read, or refused in one line, in bounded time and memory. Work is done in processes of
its own, which a watch ends when they take too long; what they were at is kept.
"""

from __future__ import annotations

import argparse
import logging
import multiprocessing
import os
import resource
import sys
import tempfile
import time
import traceback
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Database
from fuzz_mutations import damaged

from can_rig.decoding.decode import Decoder
from can_rig.errors import RigError
from can_rig.frames.databases import load_database
from can_rig.logs.frames import FD_BYTES, Frames
from can_rig.logs.reading import read_log
from can_rig.replaying.replay import OpenLoop
from can_rig.replaying.rig_frames import recorded
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from can_rig.views.log_statistics import LogStatistics

CORPUS: Final = Path(__file__).parent.parent / "tests" / "rig" / "fuzz" / "corpus"
LONGEST_S: Final = 10.0
MOST_BYTES: Final = 1 << 30
REPORT_EVERY: Final = 50
POLL_S: Final = 5.0
_DATABASES: Final = (".dbc", ".sym", ".kcd")
_DRIVE: Final = "drive.log"


def corpus() -> list[Path]:
    """The files that are damaged."""
    return sorted(path for path in CORPUS.iterdir() if path.is_file())


def read(path: Path) -> None:
    """Read a log, or a database, as a command would.

    Raises:
        RigError: it is refused.
        AssertionError: what was read cannot be.
    """
    if path.suffix in _DATABASES:
        for strict in (True, False):
            try:
                decoder = Decoder(load_database(path, strict))
            except RigError:
                if strict:
                    continue
                raise
            decoder.decode(every_frame(decoder))
        return
    statistics = LogStatistics(500_000, 2_000_000)
    decoder = Decoder(_j1939())
    for frames in read_log(path, 1 << 12):
        sound(frames)
        statistics.add(frames)
        decoder.decode(frames)
    statistics.finish()


def replay(path: Path) -> None:
    """Replay a log, as one of a run in lockstep and as one in real time.

    Raises:
        RigError: it is refused.
    """
    scenario = _scenario()
    network = network_of(scenario)
    for realtime in (False, True):
        answers = recorded(read_log(path), network, scenario) if realtime else None
        OpenLoop(scenario, network, recorded=answers).run(read_log(path))


@cache
def _j1939() -> Database:
    return load_database(CORPUS / "j1939.dbc")


@cache
def _scenario() -> Scenario:
    return load("thesis-step", ())


def every_frame(decoder: Decoder) -> Frames:
    """A frame of 64 bytes for each message of a database."""
    known = list(decoder.names())
    count = len(known)
    return Frames(
        np.arange(count, dtype=np.int64),
        np.array([identifier for identifier, _ in known], np.uint32),
        np.array([extended for _, extended in known], np.uint8),
        np.zeros(count, np.uint8),
        np.full(count, FD_BYTES, np.uint8),
        np.random.default_rng(1).integers(0, 256, (count, FD_BYTES), dtype=np.uint8),
        ("can0",),
    )


def sound(frames: Frames) -> None:
    """Refuse columns that no reader may give.

    Raises:
        AssertionError: what is wrong.
    """
    count = len(frames)
    columns = (frames.arbitration_id, frames.flags, frames.channel, frames.length, frames.data)
    assert all(len(column) == count for column in columns), "columns of different lengths"
    if count:
        assert frames.length.max() <= FD_BYTES, "a length above 64"
        assert frames.arbitration_id.max() < 1 << 29, "an identifier above 29 bits"
        assert frames.channel.max() < len(frames.channels), "a bus without a name"
        behind = np.arange(frames.data.shape[1]) >= frames.length[:, None]
        assert not (frames.data * behind).any(), "bytes beyond the end of a payload"


def attempt(path: Path, text: bytes) -> str | None:
    """What is wrong with how a damaged file is dealt with; None: nothing."""
    path.write_bytes(text)
    begin = time.process_time()  # other programs on this machine do not count
    try:
        (replay if path.name == _DRIVE else read)(path)
    except RigError as error:
        if "\n" in str(error):
            return f"an error of several lines: {error}"
    except Exception:
        return traceback.format_exc()
    took_s = time.process_time() - begin
    return f"took {took_s:.1f} s" if took_s > LONGEST_S else None


def work(names: list[str], numbers: range, pipe: Connection) -> None:
    """Try every number on every file; send the position and each finding."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    logging.disable(logging.CRITICAL)
    texts = {name: (CORPUS / name).read_bytes() for name in names}
    alike = {n: [t for m, t in texts.items() if Path(m).suffix == Path(n).suffix] for n in names}
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            attempt(Path(folder) / name, texts[name])  # compiles
        for done, number in enumerate(numbers):
            for name in names:
                pipe.send(("at", name, number))
                found = attempt(Path(folder) / name, damaged(texts[name], alike[name], number))
                if found is not None:
                    pipe.send(("found", name, number, found))
            used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
            if done % REPORT_EVERY == 0 or used > MOST_BYTES:
                pipe.send(("memory", used))
            if used > MOST_BYTES:
                pipe.send(("found", "one of them", number, f"{used >> 20} MB of memory"))
                return


def processor_s(pid: int | None) -> float:
    """The processor time that a process has used so far [s]; what others do counts little."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()
    except OSError:
        return 0.0  # it has ended
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def watched(names: list[str], numbers: range) -> list[tuple[str, int, str]]:
    """Findings of `work`, and inputs that end `work` or take too long."""
    here, there = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.Process(target=work, args=(names, numbers, there), daemon=True)
    process.start()
    there.close()
    found: list[tuple[str, int, str]] = []
    at = ("nothing", 0)
    most = 0
    patience_s = 600.0  # the first ones compile
    since_s = 0.0
    try:
        while here.poll(POLL_S) or processor_s(process.pid) - since_s < patience_s:
            if not here.poll():
                continue
            what = here.recv()
            since_s = processor_s(process.pid)
            if what[0] == "at":
                at = what[1:]
            elif what[0] == "memory":
                most = max(most, what[1])
                patience_s = 6 * LONGEST_S
            else:
                found.append(what[1:])
                print(f"{what[1]} {what[2]}: {what[3]}", flush=True)
        found.append((*at, "no end"))
        process.kill()
    except EOFError:
        process.join()
        if process.exitcode:
            found.append((*at, f"the process ended with {process.exitcode}"))
    print(f"{len(numbers) * len(names)} files, {most >> 20} MB at most, {len(found)} findings")
    return found


def main() -> None:
    """Run, and say what was found; exit status 1 where anything was."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000, help="damaged files [100000]")
    parser.add_argument("--first", type=int, default=0, help="the first number [0]")
    parser.add_argument("--only", default="", help="files whose name begins so")
    parser.add_argument("--keep", type=Path, help="a folder for the files of the findings")
    options = parser.parse_args()
    names = [path.name for path in corpus() if path.name.startswith(options.only)]
    each = -(-options.inputs // len(names))
    found = watched(names, range(options.first, options.first + each))
    if options.keep is not None:
        options.keep.mkdir(parents=True, exist_ok=True)
        for name, number, _ in found:
            if (CORPUS / name).is_file():
                text = (CORPUS / name).read_bytes()
                alike = [
                    (CORPUS / m).read_bytes() for m in names if Path(m).suffix == Path(name).suffix
                ]
                (options.keep / f"{number}-{name}").write_bytes(damaged(text, alike, number))
    for name, number, what in found:
        print(f"{name} {number}: {what.splitlines()[-1]}")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
