"""Notes before a run on the user's frames: protection, other traffic, ranges, steps."""

import math
from collections.abc import Iterator

from can_rig.drawing.names import names_of, with_unit
from can_rig.frames.comparison_frames import SENDERS, ComparisonFrame
from can_rig.frames.network import Network
from can_rig.scenario.settings import Scenario

COARSE = 0.01
"""Share of a command's range; limit for the command's change by one step of the output."""


def frame_notes(network: Network) -> Iterator[str]:
    """Lines on the frames alone: unprotected frames, identifiers shared with other messages."""
    if network.unprotected:
        yield (
            f"network: {len(network.unprotected)} of 5 frames unprotected "
            f"({', '.join(network.unprotected)}): what is damaged, repeated or forged is used"
        )
    if not network.has_ticks:
        yield "network: no network.tick: runs in real time (--realtime) only, not in lockstep"
    for collision in network.collisions:
        yield f"network: identifiers collide: {collision}"
    compared = {ComparisonFrame(node).frame_id for node in SENDERS}
    for codec in network:
        if codec.frame_id in compared and not codec.extended:
            yield (
                f"network: identifiers collide: {codec.name} has 0x{codec.frame_id:X}, with which "
                "nodes that are started by hand compare their scenarios"
            )


def signal_notes(scenario: Scenario, network: Network, gains: tuple[float, float]) -> Iterator[str]:
    """Lines on the signals' ranges and steps.

    Args:
        scenario: the run.
        network: its frames.
        gains: rms of each command for white noise of rms 1 in the output.
    """
    names, limits = names_of(scenario.plant), scenario.limits
    for key, limit, codec, name in (
        ("torque_nm", limits.torque_nm, network.command_1, names.command_1),
        ("force_difference_n", limits.force_difference_n, network.command_2, names.command_2),
    ):
        if limit is not None and limit > codec.maximum:
            yield (
                f"network: limits.{key} = {limit:g}: {codec.name}.{codec.signal_name} carries "
                f"±{with_unit(f'{codec.maximum:g}', name.unit)} only, which is the limit"
            )
    rounding = network.feedback.lsb / math.sqrt(12.0)
    for gain, codec, name in zip(
        gains, (network.command_1, network.command_2), names[1:], strict=True
    ):
        if COARSE * codec.maximum < gain * rounding < math.inf:
            yield (
                f"network: {network.feedback.name}.{network.feedback.signal_name} is too coarse: "
                f"its step of {network.feedback.lsb:g} moves {name.said} by "
                f"{with_unit(f'{gain * rounding:.3g}', name.unit)} rms, above "
                f"{COARSE:.0%} of what {codec.name}.{codec.signal_name} carries"
            )
