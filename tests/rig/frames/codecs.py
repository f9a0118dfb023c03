"""What the tests of frames draw from: the frames of both shipped DBCs, and values to send."""

from pathlib import Path

import cantools
from hypothesis import strategies as st

from can_rig.frames.network import load_network

DBC = Path(__file__).parents[3] / "dbc"
STEER_BY_WIRE = DBC / "steer_by_wire.dbc"
PAIRS = [
    (codec, cantools.database.load_file(path, strict=True).get_message_by_name(codec.name))
    for path in (STEER_BY_WIRE, DBC / "plant_by_numbers.dbc")
    for codec in load_network(path)
]

codec_pairs = st.sampled_from(PAIRS)
codecs = codec_pairs.map(lambda pair: pair[0])
ticks = st.integers(0, 2**40)
floats = st.one_of(st.floats(), st.floats(-30, 30), st.floats(-3e6, 3e6))
