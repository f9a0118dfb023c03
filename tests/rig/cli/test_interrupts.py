"""Ctrl-C while a command is still being imported: exit status 130 and not a word."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

PRESS = """
import os, signal, sys
class Press:
    @staticmethod
    def find_spec(name, path, target=None):
        if name == os.environ["PRESS_AT"]:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Press)
"""


def pressed_at(module: str, folder: Path, *arguments: str, **options: object) -> tuple[int, str]:
    """Exit status and standard error of ``can-rig``, with Ctrl-C when it imports ``module``."""
    (folder / "sitecustomize.py").write_text(PRESS)
    paths = [str(folder), str(Path(__file__).parents[3])]
    environment = os.environ | {"PRESS_AT": module, "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(
        [sys.executable, *arguments],
        env=environment, capture_output=True, text=True, timeout=300, check=False, **options,
    )  # fmt: skip
    return done.returncode, done.stderr


MODULES = ["click", "numpy", "can_rig.assessment.stability"]


@pytest.mark.parametrize("module", MODULES)
def test_while_it_imports(module: str, tmp_path: Path) -> None:
    assert pressed_at(module, tmp_path, "-m", "can_rig", "check") == (130, "")


def test_of_the_console_script(tmp_path: Path) -> None:
    code = "from can_rig.__main__ import main; main()"
    assert pressed_at("numpy", tmp_path, "-c", code, "check") == (130, "")


def test_where_it_is_ignored_it_stays_ignored(tmp_path: Path) -> None:
    def ignore() -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    words = ("-m", "can_rig", "scenarios")
    assert pressed_at("click", tmp_path, *words, preexec_fn=ignore) == (0, "")


def test_a_command_that_has_started_tidies_up(tmp_path: Path) -> None:
    """Once the command is there, Ctrl-C is an exception: what was half written goes away."""
    log, out = tmp_path / "a.log", tmp_path / "a.csv"
    log.write_text("(0.000000) can0 101#00\n")
    words = ("-m", "can_rig", "decode", str(log), "--out", str(out))
    assert pressed_at("can_rig.decoding.tables", tmp_path, *words)[0] == 130
    assert sorted(path.name for path in tmp_path.glob("*a.*")) == ["a.log"]
