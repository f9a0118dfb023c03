"""A wheel of this checkout, installed elsewhere, runs a scenario with the files it brought."""

import json
import os
import site
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder that the wheel is installed to, and nothing else."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder]
    subprocess.run([*build, CHECKOUT], check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    target = folder / "target"
    install = ["install", "--no-deps", "--no-index", "--target", target, wheel]
    subprocess.run([*pip, *install], check=True, capture_output=True)
    return target


def test_the_wheel_runs_far_from_its_checkout(installed, tmp_path):
    # -S leaves out the path files of editable installs, so nothing leads to the checkout.
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(installed), *site.getsitepackages()])
    }
    python = [sys.executable, "-S"]
    where = (
        "import sys, can_rig, firmware_model as f; print(can_rig.__file__, f.__file__, sys.path)"
    )
    found = subprocess.run(
        [*python, "-c", where],
        cwd=tmp_path, env=environment, check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    assert found.count(str(installed)) == 3
    assert f"'{CHECKOUT}'" not in found
    run = [*python, "-m", "can_rig", "run", "thesis-step", "--set", "duration_s=0.2"]
    done = subprocess.run(  # interpreted, for nothing is compiled here yet
        [*run, "--out", "run", "--in-process", "--allow-unstable"],
        cwd=tmp_path, env={**environment, "NUMBA_DISABLE_JIT": "1"},
        check=False, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len((tmp_path / "run" / "bus.log").read_text().splitlines()) == 1000
    assert json.loads((tmp_path / "run" / "run.json").read_text())["outcome"] == "complete"


def test_it_holds_the_packages_the_frames_and_the_scenarios_and_no_tests(installed):
    names = {str(path.relative_to(installed)) for path in installed.rglob("*") if path.is_file()}
    shipped = "can_rig/scenario/shipped"
    for folder, package in (("dbc", "can_rig/dbc"), (shipped, shipped)):
        for path in (CHECKOUT / folder).iterdir():
            assert f"{package}/{path.name}" in names
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)
    assert {"can_rig/py.typed", "firmware_model/__init__.py"} <= names
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} <= {
        "can_rig", "firmware_model", "bin",
    }  # fmt: skip
