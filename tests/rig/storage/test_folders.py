"""Folders of results: replacement, survivors, and simultaneous writers."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import pytest

from can_rig.errors import RigError, RunFolderError
from can_rig.results.run_folder import RUN_FOLDER
from can_rig.storage import folders
from can_rig.storage.files import move_up
from can_rig.storage.folders import Kind, NewFolder, refuse_folder, whole_folder
from tests.helpers import asked, refused

SHORT = ("--set", "duration_s=0.3", "--set", "fault.at_s=0.2")
RUN = ("run", "ideal", "--in-process", *SHORT)
COMMANDS: dict[str, tuple[object, ...]] = {
    "run": RUN,
    "campaign": ("campaign", "losses", "--runs", 2, "--workers", 1, *SHORT, "--set",
                 "reference.kind=step"),
    "export": ("export", "ideal"),
    "decode": ("decode", "LOG"),
    "what-if": ("replay", "LOG", "--what-if", "--scenario", "ideal", *SHORT),
}  # fmt: skip
LOOKS_LIKE = Kind("a test", "marker", lambda _: ["marker", "one", "two"], lambda _: True)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A folder of each kind."""
    folder = tmp_path_factory.mktemp("results")
    for name, words in COMMANDS.items():
        done = asked(*of_log(words, folder), "--out", folder / name)
        assert done.returncode in {0, 1}, done.stderr
    return folder


def of_log(words: tuple[object, ...], results: Path) -> list[object]:
    return [results / "run" / "bus.log" if word == "LOG" else word for word in words]


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def with_notes(folder: Path) -> tuple[dict[str, bytes], list[int]]:
    """The user's files in a folder of results: their contents and inode numbers."""
    (folder / "mine" / "deep").mkdir(parents=True)
    (folder / "notes.txt").write_text("notes")
    (folder / "mine" / "deep" / "run.json").write_text("mine")
    return notes_of(folder)


def notes_of(folder: Path) -> tuple[dict[str, bytes], list[int]]:
    names = ("notes.txt", "mine/deep/run.json", "mine", ".")
    files = {name: (folder / name).read_bytes() for name in names[:2]}
    return files, [(folder / name).stat().st_ino for name in names]


@pytest.mark.parametrize("kind", COMMANDS)
def test_force_keeps_foreign_files_and_replaces_no_other_kind(kind, results, tmp_path):
    words = of_log(COMMANDS[kind], results)
    same = {"run": "what-if", "what-if": "run"}.get(kind, kind)
    for other in COMMANDS:
        folder = tmp_path / other
        shutil.copytree(results / other, folder)
        notes = with_notes(folder)
        before = contents(folder)
        assert "there already" in refused(*words, "--out", folder)
        assert contents(folder) == before
        if other == same:
            done = asked(*words, "--out", folder, "--force")
            assert done.returncode in {0, 1}, done.stderr
            own = {path.name for path in (results / kind).iterdir()}
            assert {path.name for path in folder.iterdir()} == own | {"notes.txt", "mine"}
            assert notes_of(folder) == notes
        elif other != kind:
            assert "--force" not in refused(*words, "--out", folder)
            assert "so --force does not replace it" in refused(*words, "--out", folder, "--force")
            assert contents(folder) == before
    assert {path.name for path in tmp_path.iterdir()} == {*COMMANDS}


@contextmanager
def no_cluster(*_: object) -> Iterator[None]:
    raise RigError("tcp://127.0.0.1:1: cannot be reached")
    yield


@pytest.mark.parametrize("there", [True, False])
def test_a_campaign_that_does_not_begin_takes_nothing_away(there, results, tmp_path, monkeypatch):
    monkeypatch.setattr("can_rig.cli.campaign.computing", no_cluster)
    out = tmp_path / "out"
    if there:
        shutil.copytree(results / "campaign", out)
        with_notes(out)
    before = contents(tmp_path)
    refused = asked(*COMMANDS["campaign"], "--out", out, "--force")
    assert refused.returncode == 2
    assert contents(tmp_path) == before
    assert {path.name for path in tmp_path.iterdir()} == ({"out"} if there else set())


def full(*_: object) -> None:
    raise RigError("no space left on device")


def test_an_interrupted_campaign_replaces_the_old_one_once_it_is_whole(
    results, tmp_path, monkeypatch
):
    out = tmp_path / "out"
    shutil.copytree(results / "campaign", out)
    notes, before = with_notes(out), contents(out)
    words = [*COMMANDS["campaign"], "--seed", 7, "--out", out]
    with monkeypatch.context() as patch:
        patch.setattr("can_rig.cli.campaign.write_report", full)
        assert asked(*words, "--force").returncode == 2
    assert contents(out) == before
    assert f"{out}.unfinished: holds what an earlier command recorded" in refused(*words, "--force")
    assert asked(*words, "--resume").returncode in {0, 1}
    assert (out / "campaign.json").read_bytes() != before["campaign.json"]
    assert notes_of(out) == notes
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_command_that_is_killed_while_it_replaces_is_finished_by_the_next(tmp_path, monkeypatch):
    class KilledError(BaseException):
        """As if the process was gone."""

    def half(whole: Path) -> None:
        (whole / "marker").replace(whole.parent / "marker")
        raise KilledError

    path = tmp_path / "a"
    for text in ("old", "new"):
        monkeypatch.setattr(folders, "move_up", half if text == "new" else move_up)
        with (
            pytest.raises(KilledError) if text == "new" else nullcontext(),
            whole_folder(path, LOOKS_LIKE, force=True) as made,
        ):
            for name in ("marker", (text == "old" and "two") or "one"):
                (made / name).write_text(text)
        (path / "notes.txt").write_text("mine")
    assert not (path / "one").exists()
    refuse_folder(path, LOOKS_LIKE, force=True)
    assert {p.name: p.read_text() for p in path.iterdir()} == {
        "marker": "new", "one": "new", "notes.txt": "mine",
    }  # fmt: skip


@pytest.mark.parametrize("in_the_way", ["folder", "foreign file"])
def test_what_is_in_the_way_of_a_file_stays_and_so_does_everything(in_the_way, tmp_path):
    path = tmp_path / "a"
    path.mkdir()
    (path / "marker").write_text("old")
    if in_the_way == "folder":
        (path / "two").mkdir()
    else:
        (path / "three").write_text("mine")
    before = contents(path)
    with (
        pytest.raises(RunFolderError, match="in it is not of a test"),
        whole_folder(path, LOOKS_LIKE, force=True) as made,
    ):
        for name in ("marker", "two", "three"):
            (made / name).write_text("new")
    assert contents(path) == before
    assert [each.name for each in tmp_path.iterdir()] == ["a"]


def test_two_commands_do_not_write_one_folder(results, tmp_path):
    shutil.copytree(results / "run", tmp_path / "old")
    for target in (tmp_path / "new", tmp_path / "old"):
        before = contents(target)
        with NewFolder.create(target, RUN_FOLDER, force=True):
            assert "another command is writing into it" in refused(*RUN, "--out", target, "--force")
        assert contents(target) == before


def test_a_folder_that_a_killed_run_had_not_filled_yet_is_taken(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    assert asked(*RUN, "--out", out).returncode == 0
    for name in ("out.unfinished", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "bus.log").touch()
    assert asked(*RUN, "--out", out, "--force").returncode == 0
    assert asked(*RUN, "--out", tmp_path / "other").returncode == 0
    assert {path.name for path in tmp_path.iterdir()} == {"out", "other"}


@pytest.mark.parametrize("command", ["run", "export", "decode"])
def test_a_link_to_a_folder_means_the_folder(command, results, tmp_path, monkeypatch):
    shutil.copytree(results / command, tmp_path / "real")
    (tmp_path / "link").symlink_to("real")
    (tmp_path / "nowhere").symlink_to("nothing")
    words = of_log(COMMANDS[command], results)
    assert asked(*words, "--out", "link", "--force").returncode == 0
    assert (tmp_path / "link").readlink() == Path("real")
    monkeypatch.chdir(tmp_path / "real")
    assert asked(*words, "--out", ".", "--force").returncode == 0
    monkeypatch.chdir(tmp_path)
    assert "is a link to nothing" in refused(*words, "--out", "nowhere", "--force")
    assert {path.name for path in tmp_path.iterdir()} == {"real", "link", "nowhere"}
    assert {path.name for path in (tmp_path / "real").iterdir()} == {
        path.name for path in (results / command).iterdir()
    }


def test_runs_of_the_same_second_have_folders_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setattr("time.strftime", lambda _: "20260101-000000")
    for _ in range(2):
        assert asked(*RUN).returncode == 0
    assert {path.name for path in (tmp_path / "runs").iterdir()} == {
        "ideal-20260101-000000", "ideal-20260101-000000-2",
    }  # fmt: skip
