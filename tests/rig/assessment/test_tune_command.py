"""``can-rig tune`` on the command line: bad words, its picture, table, options and JSON."""

import json
import re

import matplotlib.image
import pytest

from can_rig.assessment.tuning import search
from can_rig.scenario.loading import load
from tests.helpers import asked, refused, sets, succeeded
from tests.rig.assessment.tuned import SETTINGS, SMALL, compiled_only

pytestmark = compiled_only


BAD = {
    "share": (["--box", "1"], "must be 0 to below 1"),
    "negative share": (["--box", "-0.1"], "must be 0 to below 1"),
    "nan": (["--box", "nan"], "must be 0 to below 1"),
    "no such key": (["--box-set", "plant.sped_mps=1..2"], r"LOW..HIGH, did you mean speed_mps\?"),
    "no range": (["--box-set", "plant.speed_mps=12"], "must be plant.KEY=LOW..HIGH"),
    "turned round": (["--box-set", "plant.speed_mps=12..8"], "must be plant.KEY=LOW..HIGH"),
    "no car": (["--box-set", "plant.mass_kg=-1..8"], "box: mass_kg = -1"),
    "noise limit without noise": (
        ["ideal", "--noise-limit", "300"], "and so must plant.sensor.noise_mps2"
    ),
    "spare": (["--spare-ticks", "-1"], "must be 0 to 64"),
    "much to spare": (["--spare-ticks", "100000"], "must be 0 to 64"),
    "chapter 2": (["chapter-2", "--box", "0"], "chapter-2"),
    "off": (["--set", "design.compensation=off"], "compensation = 'off'"),
    "no reference": (["--set", "reference.amplitude_mps2=0"], "would not show"),
}  # fmt: skip


@pytest.mark.parametrize(("arguments", "reason"), BAD.values(), ids=BAD)
def test_what_is_wrong_is_one_line_with_exit_status_2(arguments, reason):
    assert re.search(reason, refused("tune", *arguments))


def test_the_command_writes_the_picture_the_table_and_the_options(tmp_path, monkeypatch):
    monkeypatch.setattr(search, "grid", lambda scenario: SMALL)
    monkeypatch.setenv("COLUMNS", "80")
    arguments = ("tune", "thesis-step", *sets(*SETTINGS), "--box", "0", "--out", tmp_path)
    done = asked(*arguments, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    values = json.loads(done.stdout)
    image = matplotlib.image.imread(tmp_path / "tuning.png")
    assert image.shape[0] > 800
    assert image[..., :3].std() > 0.05
    assert "tuning.png: exists" in refused(*arguments)
    done = succeeded(*arguments, "--force")
    shown = done.stdout
    assert values["options"] in shown
    assert max(len(line) for line in shown.splitlines()[:-3]) <= 80
    assert sum(line.startswith(">") for line in shown.splitlines()) == 1
    # The printed options select the chosen tuning.
    chosen_settings = [*SETTINGS, *values["options"].replace("--set ", "").split()]
    chosen = load("thesis-step", chosen_settings).design
    assert (chosen.tau_s, chosen.tau_q_s) == (
        values["chosen"]["tau_s"], values["chosen"]["tau_q_s"]
    )  # fmt: skip


def test_where_none_passes_the_table_says_why_and_the_status_is_1():
    weak = ("--set", "limits.force_difference_n=100.0")
    done = asked("tune", "default", *weak)
    assert done.returncode == 1
    counted, advice = done.stdout.splitlines()[1:]
    assert counted.split(maxsplit=1)[1].endswith("because of the limit of X_diff")
    assert advice.startswith(f"none of {counted.split()[0]} tunings passes: limits.force_diff")
    values = json.loads(asked("tune", "default", *weak, "--json").stdout)
    assert values["chosen"] is None
    assert values["refused"] == {"force_limit": int(counted.split()[0])}
