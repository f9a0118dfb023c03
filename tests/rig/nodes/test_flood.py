"""A flood on the default bus; ``tools/flood`` is the same with a million frames and processes."""

import random
from collections import Counter

import can

from can_rig.buses.bus import open_bus
from can_rig.controllers.our_law import PYTHON
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.runner import run_in_process
from can_rig.scenario.loading import load
from tests.helpers import record

TICKS, A_TICK = 300, 50
OWN = 0x100, 0x101, 0x110, 0x111, 0x120


def test_a_flood_changes_no_command_and_is_in_the_log_to_the_last_frame(tmp_path):
    """Of data, extended and remote frames of the rig's own identifiers and of others."""
    rng = random.Random(7)
    bus, log = f"local:{tmp_path / 'bus'}", tmp_path / "flooded.log"
    settings = [f"duration_s={TICKS / 1000}"]
    sent = []
    with open_bus(bus) as other:

        def flood(_tick):
            for _ in range(A_TICK):
                kind = rng.choice(("data", "data", "extended", "remote"))
                message = can.Message(
                    arbitration_id=rng.choice((rng.getrandbits(11), *OWN)),
                    is_extended_id=kind == "extended",
                    is_remote_frame=kind == "remote",
                    dlc=8 if kind == "remote" else None,
                    data=None if kind == "remote" else rng.randbytes(rng.choice((0, 3, 8, 8))),
                )
                other.send(message)
                name = f"{message.arbitration_id:0{8 if kind == 'extended' else 3}X}"
                content = "R8" if kind == "remote" else message.data.hex().upper()
                sent.append(f"{name}#{content} R")

        scenario = load("thesis-step", settings)
        summary = run_in_process(scenario, bus, log, StopRequest(), flood, PYTHON)
    lines = [line.split(" ", 2)[2] for line in log.read_text().splitlines()]
    quiet = record(tmp_path, *settings)[0].read_text().splitlines()
    wanted = [line.split(" ", 2)[2] for line in quiet]
    remaining = iter(lines)
    assert all(line in remaining for line in wanted)
    assert [line for line in lines if line.endswith("T")] == [w for w in wanted if w.endswith("T")]
    assert len(sent) == TICKS * A_TICK
    assert sum((Counter(wanted + sent) - Counter(lines)).values()) == 0, "lost"
    assert len(lines) == len(wanted + sent)
    judged = lines[: lines.index(wanted[-1])]  # what came after the last status was not
    for name, identifier in (("STEER_TORQUE_CMD", "110#"), ("CONTROLLER_STATUS", "120#")):
        foreign = sum(line.startswith(identifier) and "#R8" not in line for line in judged)
        ours = sum(line.startswith(identifier) for line in wanted[:-1])
        assert sum(summary.rejected_frames[name].values()) == foreign - ours > 0
    assert summary.bus_events == {}
