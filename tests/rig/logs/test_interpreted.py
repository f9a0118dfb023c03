"""The compiled line loops run interpreted with the same result."""

import os
import subprocess
import sys
from pathlib import Path

SHOWN = """
import sys
from can_rig.logs.reading import read_log
for name in sys.argv[1:]:
    for frames in read_log(name):
        print(*frames.rows(), frames.channels, frames.data.tobytes())
"""
TEXTS = ("busmaster.log", "candump.log", "canoe.asc", "microchip.log", "pcan-2.1.trc")


def test_the_compiled_lines_are_those_that_run_interpreted():
    corpus = Path(__file__).parents[1] / "fuzz/corpus"
    words = [sys.executable, "-c", SHOWN, *(str(corpus / name) for name in TEXTS)]
    shown = [
        subprocess.run(words, env=os.environ | more, capture_output=True, check=True).stdout
        for more in ({}, {"NUMBA_DISABLE_JIT": "1"})
    ]
    assert shown[0].count(b"\n") >= len(TEXTS)
    assert shown[0] == shown[1]
