"""The node in C by the clock: a feedback that does not come is missed, as in Python."""

from __future__ import annotations

import ctypes
import random

import pytest

from can_rig.assessment.resolve import load
from can_rig.export.application import application
from can_rig.export.compiler import shared_library
from can_rig.frames.endpoints import Transmitter
from can_rig.nodes.lockstep import ControllerNode
from can_rig.scenario.build import network_of

TICK_US = 2000
SCENARIO = load("default", ["duration_s=1", f"tick_s={TICK_US / 1e6}"])
DRIVER = """
#include <stddef.h>
#include "ecu.h"
static void (*sender)(uint16_t, const uint8_t *);
void set_sender(void (*called)(uint16_t, const uint8_t *)) { sender = called; }
void ecu_send(uint16_t id, const uint8_t data[8]) { sender(id, data); }
size_t ecu_size(void) { return sizeof(struct ecu); }
"""
Sender = ctypes.CFUNCTYPE(None, ctypes.c_uint16, ctypes.POINTER(ctypes.c_uint8))


class ByTheClock:
    """The application with a CAN driver of Python."""

    def __init__(self) -> None:
        path = shared_library(application(SCENARIO) | {"driver.c": DRIVER})
        self.library = ctypes.CDLL(str(path))
        self.library.ecu_is_overdue.restype = ctypes.c_bool
        self.library.ecu_on_frame.restype = ctypes.c_bool
        self.sent: list[tuple[int, bytes]] = []
        self._sender = Sender(lambda frame, data: self.sent.append((frame, bytes(data[:8]))))
        self.library.set_sender(self._sender)
        self.memory = ctypes.create_string_buffer(self.library.ecu_size())
        self.library.ecu_init(self.memory)

    def take(self, frame_id: int, data: bytes, now_us: int) -> None:
        now = ctypes.c_uint32(now_us)
        if self.library.ecu_on_frame(self.memory, frame_id, len(data), data, now):
            self.library.ecu_on_tick(self.memory)

    def overdue(self, now_us: int) -> bool:
        return bool(self.library.ecu_is_overdue(self.memory, ctypes.c_uint32(now_us)))


@pytest.mark.parametrize("seed", range(4))
def test_a_feedback_that_does_not_come_is_missed(seed: int) -> None:
    choose, network, ecu = random.Random(seed), network_of(SCENARIO), ByTheClock()
    expected: list[tuple[int, bytes]] = []
    python = ControllerNode(
        SCENARIO, network, lambda m: expected.append((m.arbitration_id, bytes(m.data)))
    )
    reference, feedback = Transmitter(network.reference), Transmitter(network.feedback)
    start_us = 2**32 - 50 * TICK_US  # the clock wraps
    assert not ecu.overdue(start_us)
    missed = 0
    for tick in range(120):
        at_us = start_us + tick * TICK_US
        wanted, measured = (
            each.frame(choose.uniform(-2, 2), tick) for each in (reference, feedback)
        )
        python.take(wanted)
        ecu.take(wanted.arbitration_id, bytes(wanted.data), at_us)
        if tick and choose.random() < 0.3:
            assert not ecu.overdue(at_us + TICK_US // 2 - 200)
            assert ecu.overdue(at_us + TICK_US // 2 + 200)
            ecu.library.ecu_on_tick(ecu.memory)
            python.miss()
            missed += 1
        else:
            late_us = choose.randrange(-100, 100)
            python.take(measured)
            ecu.take(measured.arbitration_id, bytes(measured.data), at_us + late_us)
        assert not ecu.overdue(at_us + TICK_US // 2 + 200)
        assert ecu.sent == expected
    assert missed > 20
    assert len(expected) == 3 * 120
