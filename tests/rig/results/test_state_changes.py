"""Changes of the state: found in pieces of any size, each at its row."""

import numpy as np
from hypothesis import given, strategies as st

from can_rig.drawing.names import names_of
from can_rig.results.state_changes import StateChanges
from can_rig.scenario.build import network_of
from firmware_model.law.status import FaultState
from tests.helpers import load

SCENARIO = load("ideal")
NAMES, NETWORK = names_of(SCENARIO.plant), network_of(SCENARIO)
WORDS = dict(zip(FaultState, ["clear", "suspected", "confirmed", "cannot tell"], strict=True))


@given(
    codes=st.lists(st.sampled_from([*FaultState, None]), max_size=40),
    parts=st.lists(st.integers(0, 9), max_size=8),
    first=st.booleans(),
)
def test_every_other_code_than_the_last_known_one_and_the_first_where_wanted(codes, parts, first):
    wanted, last = [], None
    for row, code in enumerate(codes):
        if code is not None and code != last:
            wanted.append((0.5 * row, f"fault state: {WORDS[code]}"))
            last = code
    column = np.array([np.nan if code is None else code for code in codes], dtype=np.float64)
    time_s = 0.5 * np.arange(len(codes))
    changes, found, at = StateChanges(NAMES, NETWORK, first=first), [], 0
    for part in [*parts, len(codes)]:
        rows = slice(at, at + part)
        found += changes.of("fault state", time_s[rows], column[rows])
        at += part
    assert found == wanted[0 if first else 1 :]
