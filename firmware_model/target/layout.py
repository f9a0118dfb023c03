"""The fixed memory layout of the controller: a constant table and a private state.

Two C structs, as numpy record types, in float64 or float32. The table is written once by
``tables.build`` and never again; everything that changes lives in the state.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Literal

import numpy as np

MAX_SECTIONS = 8  # of each filter: order 16
MAX_LATENCY_TICKS = 64

Precision = Literal["float64", "float32"]
Record = Any  # a numpy record of one of the types below
RecordArray = Any  # an array of them, shape (n,)


class Mode(IntEnum):
    """What the controller is doing, as its status frame says it."""

    INIT = 0
    """No tick has run since ``init`` or ``reset``."""
    RUN = 1
    """The last tick was computed from its inputs."""
    HOLD = 2
    """The last tick's input was not a number: the last good commands are held."""
    OFF = 3
    """Reserved: a controller that is switched off sends this."""


class FaultState(IntEnum):
    """What ``decision`` says of d̂. It isolates nothing: a biased D* looks the same."""

    CLEAR = 0
    """d̂ is not too much, and the loss of all of channel 1 would make it so."""
    SUSPECTED = 1
    """d̂ is too much, not yet for long enough."""
    CONFIRMED = 2
    """It has been, and has not since fallen to what a channel that works would leave."""
    CANNOT_TELL = 3
    """Channel 1 does so little now that its loss would not show."""


#: every filter of the controller, in the order of (2.1), (2.37), (3.32)
FILTERS = ("tracking", "estimator_1", "estimator_2", "one_plus_q", "compensator")


def table_type(precision: Precision = "float64") -> np.dtype[np.void]:
    """Layout of the constant table."""
    real = np.dtype(precision)
    sections = [(name, real, (MAX_SECTIONS, 5)) for name in FILTERS]
    counts = [(f"{name}_n", np.int64) for name in FILTERS]
    reals = [
        "feedback",  # 1: error = reference - measurement; 0: open loop
        "reference_to_2",  # share of the reference that goes to channel 2 directly
        "steady_1",  # command 1 per unit of a settled reference
        "estimator_feedthrough_2",  # of F1's second channel, when it acts within the tick
        "compensator_feedthrough",
        "q_feedthrough",  # of 1 + Q
        "loop_inverse",  # 1/(1 - algebraic loop gain)
        "conditioning",  # 1/C(z → ∞): from what a limit took off the command to the error
        "limit_1",
        "limit_2",
        "slew_1",  # largest change of a command in a tick
        "slew_2",
        "slew_reference",  # largest change, in a tick, of what the reference changes in a tick
        "lsb_1",  # command grid, 0: none
        "lsb_2",
        "threshold",  # of |d̂|
        "model_share",  # of channel 1's doing that another car than the model may show as d̂
        "found_memory",  # what a tick leaves of the share that was found
        "change_memory",  # what a tick leaves of the changes of d̂
        "most_memory",  # and of the most that channel 1 has done
        "probe_amplitude",  # of command 1, half of it
        "probe_share",  # of the torque that a probe has to find lost
        "share_memory",  # what a tick leaves of the sums behind the share that is lost
        "clear_ratio",  # of the d̂ of a loss, which has to be above the threshold to clear it
    ]
    integers = [
        "integrates",
        "governs",
        "probe_ticks",  # that a probe lasts; 0: none
        "latency_ticks",
        "confirm_ticks",
        "clear_ticks",
        "on_confirmation",
    ]
    vectors = [
        ("probe_gain", real, (2,)),  # G1 at its frequency, latency included: real, imaginary
        ("probe_turn", real, (2,)),  # of half its phase in a tick: cosine, sine
    ]
    fields = [
        *sections,
        *counts,
        *vectors,
        *((n, real) for n in reals),
        *((n, np.int64) for n in integers),
    ]
    return np.dtype((np.record, fields))


def state_type(precision: Precision = "float64") -> np.dtype[np.void]:
    """Layout of the state; the last group is what a tick answers."""
    real = np.dtype(precision)
    states = [(name, real, (MAX_SECTIONS, 2)) for name in FILTERS]
    fields = [
        *states,
        ("lost", real, (MAX_SECTIONS, 2)),  # G1 driven by command 1 while it is believed lost
        ("lost_before", real),  # what that was in the last tick
        ("missed", real),  # of what is lost: not carried yet, and how it changes
        ("missed_rise", real),
        ("missed_memory", real),
        ("carried", real),  # what F̂ got of it in the last tick, and its change
        ("carried_rise", real),
        ("delay_1", real, (MAX_LATENCY_TICKS,)),  # commands on their way to the plant
        ("delay_2", real, (MAX_LATENCY_TICKS,)),
        ("delay_lost", real, (MAX_LATENCY_TICKS,)),  # what was lost, on its way into d̂
        ("acting_1", real),  # command 1 as it reached the plant in the last tick
        ("delay_at", np.int64),
        ("probe_heard", real, (4,)),  # d̂ and w at the frequency of a probe: cosine and sine parts
        ("probe_cos", real),  # half its phase
        ("probe_sin", real),
        ("probe_at", np.int64),  # the tick of a probe, from 1 on; 0: none
        ("change", real),  # of d̂ of late
        ("change_expected", real),  # of G1 u1 likewise
        ("estimate_before", real),
        ("expected_before", real),
        ("most", real),  # largest |G1 u1| of late
        ("most_change", real),  # and largest change of it
        ("offset", real),  # of d̂, that was there before the loss
        ("share_lost", real),  # of channel 1, as far as d̂ shows it
        ("share_found", real),  # that, slower than a recovery takes
        ("share_before", real),  # of G1 u1, that d̂ was before the loss
        ("share_sums", real, (2,)),  # of d̂ w and of w², fading
        ("decide_ticks", np.int64),  # ticks in a row that ask for another fault state
        ("engaged", np.int64),  # 1: compensation on confirmation acts
        ("reference", real),
        ("reference_before", real),
        ("governed", real),  # the reference that C follows, and what it changed in the last tick
        ("governed_speed", real),
        ("measurement", real),
        ("command_1", real),
        ("command_2", real),
        ("fault_estimate", real),
        ("mode", np.int64),
        ("fault_state", np.int64),
    ]
    return np.dtype((np.record, fields))
