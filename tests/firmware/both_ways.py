"""What a module prints compiled, and what interpreted."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = str(Path(__file__).parents[2])


def lines_compiled_and_interpreted(module: str) -> list[list[str]]:
    """The lines that the file ``module`` prints as a program, run either way."""
    return [
        subprocess.run(
            [sys.executable, module],
            check=True,
            capture_output=True,
            text=True,
            env={**os.environ, "NUMBA_DISABLE_JIT": flag, "PYTHONPATH": ROOT},
        ).stdout.splitlines()
        for flag in ("0", "1")
    ]
