"""A campaign whose workers are killed again and again makes the table that it makes undisturbed.

Workers are processes, or members of a local Dask cluster whose nannies restart them.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from threading import Event, Thread

import psutil
from distributed import Client, LocalCluster

from can_rig.campaigns.cluster import on_cluster
from can_rig.campaigns.execution import execute, open_folder
from can_rig.campaigns.plan import Plan, plan
from can_rig.campaigns.settings import read_campaign
from can_rig.campaigns.workers import Compute, in_processes, serially

WORKERS = 2


@contextmanager
def killing(pids: Callable[[], list[int]], every_s: float) -> Iterator[list[int]]:
    """Kill one of ``pids`` every so often; who died."""
    over, dead = Event(), list[int]()

    def kill() -> None:
        while not over.wait(every_s):
            if alive := pids():
                dead.append(random.choice(alive))
                os.kill(dead[-1], signal.SIGKILL)

    thread = Thread(target=kill)
    thread.start()
    try:
        yield dead
    finally:
        over.set()
        thread.join()


def processes() -> list[int]:
    """The workers of this process: what its fork server has started."""
    servers = [
        child for child in psutil.Process().children() if "forkserver" in " ".join(child.cmdline())
    ]
    return [worker.pid for server in servers for worker in server.children()]


def ran(folder: Path, some: Plan, workers: AbstractContextManager[Compute]) -> tuple[bytes, float]:
    """The table of the campaign, and how long it took."""
    begin = time.monotonic()
    opened = open_folder(folder, some, resume=False, force=False)
    assert execute(opened, workers, lambda: False, lambda done: None)
    return opened.table.read_bytes(), time.monotonic() - begin


def told(name: str, table: bytes, wanted: bytes, seconds: float, dead: int) -> bool:
    """One line; whether the table is the wanted one."""
    same = table == wanted
    print(f"{name}: {dead} workers killed, {seconds:.0f} s, {'identical' if same else 'DIFFERENT'}")
    return same


def main() -> None:
    """Run the campaign three times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--campaign", default="losses")
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--every", type=float, default=10.0, help="seconds from kill to kill [10]")
    options = parser.parse_args()
    some = plan(read_campaign(options.campaign, runs=options.runs))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wanted, seconds = ran(folder / "one", some, serially(some))
        print(f"one process: {options.runs} runs, {seconds:.0f} s")
        with killing(processes, options.every) as dead:
            table, seconds = ran(folder / "two", some, in_processes(some, WORKERS))
        same = told(f"{WORKERS} processes", table, wanted, seconds, len(dead))
        with (
            LocalCluster(
                n_workers=WORKERS, threads_per_worker=1, processes=True, dashboard_address=None
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):
            address = cluster.scheduler_address

            def workers() -> list[int]:
                return list(client.run(os.getpid).values())

            with killing(workers, options.every) as dead:
                table, seconds = ran(folder / "dask", some, on_cluster(some, address))
            same &= told("Dask", table, wanted, seconds, len(dead))
    sys.exit(not same)


if __name__ == "__main__":
    main()
