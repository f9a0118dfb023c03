"""What several commands share: JSON, silence, the log of python-can, completion, pictures."""

import json
import logging
import math
from pathlib import Path

import pytest
from click.shell_completion import BashComplete

from can_rig.buses.bus import _quiet
from can_rig.cli import scenarios
from can_rig.cli.main import COMMANDS, main
from can_rig.errors import INTERRUPTED
from can_rig.results import execution
from can_rig.scenario import shipped
from tests.helpers import asked, refused
from tests.rig.scenario.page_of_keys import keys_of_the_page

RUN = ("run", "thesis-step", "--set", "duration_s=0.05")


def test_scenarios_as_json():
    described = json.loads(asked("scenarios", "--json").stdout)
    assert list(described) == sorted(shipped())
    assert all(described.values())


def test_a_run_as_json_has_the_metrics_of_its_folder(tmp_path):
    done = asked(*RUN, "--json", "--silence", "7", "--out", tmp_path / "r")
    said = json.loads(done.stdout)
    summary = json.loads((tmp_path / "r" / "run.json").read_text())
    assert said["folder"] == str(tmp_path / "r")
    assert {key: summary[key] for key in ("metrics", "ticks", "outcome")}.items() <= said.items()


@pytest.mark.parametrize(
    ("words", "silence_s"),
    [((), 1.0), (("--silence", "7"), 7.0), (("--pace", "0.002"), 1.5),
     (("--injectable",), math.inf), (("--injectable", "--silence", "7"), 7.0)],
)  # fmt: skip
def test_a_run_that_may_be_paused_bears_every_silence_unless_told(words, silence_s, monkeypatch):
    asked_for: list[execution.Options] = []
    monkeypatch.setattr(execution, "execute", lambda *of: asked_for.append(of[-1]))
    assert asked(*RUN, *words).returncode == INTERRUPTED
    assert [each.timeouts.silence_s for each in asked_for] == [silence_s]  # and the paced tick


def test_a_silence_in_one_process_is_refused():
    assert "in one process no node waits" in refused(*RUN, "--in-process", "--silence", "2")


def test_python_can_is_heard_when_it_is_asked_for(monkeypatch):
    """Also while a bus is being opened, when its records go nowhere else."""
    logger = logging.getLogger("can")
    monkeypatch.setattr(logger, "level", logger.level)
    monkeypatch.setattr(logger, "handlers", [])

    def shipped_with_a_word_of_python_can() -> dict[str, Path]:
        with _quiet():
            logging.getLogger("can.bus").debug("a driver's remark")
        return {}

    monkeypatch.setattr(scenarios, "shipped", shipped_with_a_word_of_python_can)
    assert "a driver's remark" not in asked("scenarios").stderr
    assert asked("-v", "scenarios").stderr == "can.bus: a driver's remark\n"


def test_the_shell_completes_names():
    complete = BashComplete(main, {}, "can-rig", "_CAN_RIG_COMPLETE")
    assert [item.value for item in complete.get_completions([], "re")] == ["replay"]
    helps = {item.value: item.help for item in complete.get_completions([], "")}
    assert {name: helps[name] for name in COMMANDS} == {
        n: line for n, (_, line) in COMMANDS.items()
    }
    names = [item.value for item in complete.get_completions(["run"], "no")]
    assert names == ["no", "no-compensation", "noisy", "nonlinear-car", "nonminimum-phase"]
    assert "--verbose" in [item.value for item in complete.get_completions([], "--")]


def test_the_shell_completes_every_key_that_the_list_of_keys_has():
    complete = BashComplete(main, {}, "can-rig", "_CAN_RIG_COMPLETE")
    offered = [item.value for item in complete.get_completions(["run", "--set"], "")]
    assert sorted(offered) == sorted(key for key, _ in keys_of_the_page())
    assert complete.get_completions(["check", "--set"], "plant.sp")[0].value == "plant.speed_mps"


def test_a_picture_is_what_its_suffix_says(tmp_path):
    run = tmp_path / "r"
    assert asked(*RUN, "--in-process", "--out", run).returncode == 0
    for suffix, begins, words in (
        (".png", b"\x89PNG", ("plot", run, "DStar")),
        (".svg", b"<?xml", ("diff", run, run)),
        (".PDF", b"%PDF", ("plot", run, "DStar")),
    ):
        picture = tmp_path / f"picture{suffix}"
        assert asked(*words, "--out", picture).returncode == 0
        assert picture.read_bytes().startswith(begins)
