"""The saved state in C: the bytes of Python, and no damaged byte is taken."""

from __future__ import annotations

import ctypes
import math

import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.controllers.ecus import host_library
from can_rig.export.application import in_precision
from can_rig.scenario.build import network_of
from can_rig.scenario.driving import controls
from firmware_model.firmware import Firmware
from firmware_model.law.layout import state_type
from firmware_model.law.status import FaultState
from firmware_model.law.structs import Precision
from tests.rig.export.shared import PRECISIONS


def address(memory: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(memory.ctypes.data)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_c_saves_the_bytes_of_python_and_refuses_every_flipped_bit(precision: Precision) -> None:
    scenario = in_precision(load("default", []), precision)
    of = controls(scenario, network_of(scenario))
    code = ctypes.CDLL(str(host_library(scenario)))
    code.firmware_restore.restype = ctypes.c_bool
    firmware = Firmware(of.table)
    for tick in range(1500):  # no motion of the car answers the commands: a loss
        answer = firmware.step(math.sin(0.003 * tick), 0.001 * (tick % 7 - 3))
    assert answer.fault_state == FaultState.CONFIRMED
    whole = firmware.saved()

    state = firmware._states.copy()
    before = state.tobytes()
    saved = ctypes.create_string_buffer(len(whole))
    code.firmware_save(address(state), saved)
    assert saved.raw == whole
    assert state.tobytes() == before

    fresh = np.zeros(1, state_type(precision))
    code.firmware_init(address(fresh))
    before = fresh.tobytes()
    for bit in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        assert not code.firmware_restore(address(fresh), bytes(damaged)), bit
    assert fresh.tobytes() == before
    assert code.firmware_restore(address(fresh), whole)
    assert fresh["saved"].tobytes() == whole
    code.firmware_save(address(fresh), saved)
    assert saved.raw == whole
