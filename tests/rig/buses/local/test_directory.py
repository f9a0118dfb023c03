"""Where the sockets of a bus lie: names, permissions, other files."""

import fcntl
import os
import socket

import can
import pytest

from can_rig.buses.local import bus as local_bus
from can_rig.buses.local.bus import LocalBus
from tests.rig.buses.local.nodes import TIMEOUT_S, buses, frame, node, number, sockets


def test_last_node_takes_the_directory_of_a_name_away_but_not_a_users(root, tmp_path):
    with buses({}, {}):
        assert (root / "x").is_dir()
    assert not (root / "x").exists()
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    with LocalBus(str(theirs)):
        pass
    assert theirs.is_dir()


def test_other_files_in_the_directory_are_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "1-abcdef.node").write_text("looks like a node, but is no socket")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as foreign:
        foreign.bind(str(tmp_path / "foreign.sock"))
    with LocalBus(str(tmp_path)) as sender, LocalBus(str(tmp_path)) as receiver:
        sender.send(frame(1))
        assert number(receiver.recv(TIMEOUT_S)) == 1
    for name in ("notes.txt", "1-abcdef.node", "foreign.sock"):
        assert (tmp_path / name).exists()


def test_buses_of_killed_nodes_are_gone_with_the_next_start_and_no_others(root):
    with node("import time; time.sleep(60)") as killed:
        killed.kill()
        killed.wait()
        (root / "x").rename(root / "killed")
    (root / "empty").mkdir()
    (root / "with-a-file").mkdir()
    (root / "with-a-file" / "notes.txt").write_text("mine")
    (root / "link").symlink_to(root / "empty-elsewhere")
    (root / "empty-elsewhere").mkdir()
    (root / "empty-elsewhere" / "kept").write_text("mine")
    (root / "joined").mkdir()
    with (root / "joined" / ".can-generation").open("w") as joining:
        fcntl.flock(joining, fcntl.LOCK_EX)
        with node("import time; time.sleep(60)"), LocalBus("next"):
            assert {path.name for path in root.iterdir()} == {
                "x", "next", "joined", "with-a-file", "link", "empty-elsewhere",
            }  # fmt: skip
            assert len(sockets(root)) == 1
    with LocalBus("next"):
        assert {path.name for path in root.iterdir()} == {
            "next", "with-a-file", "link", "empty-elsewhere",
        }  # fmt: skip


@pytest.mark.parametrize("name", ["a/b", "", ".", "..", ".hidden"])
def test_wrong_names(name):
    with pytest.raises(can.CanInitializationError, match="must be a name without"):
        LocalBus(name)


def test_longest_path_that_a_socket_can_have(tmp_path):
    room = local_bus.PATH_MAX - len(str(tmp_path)) - 1
    with LocalBus(f"{tmp_path}/{'y' * room}") as one, LocalBus(one.channel) as other:
        one.send(frame(1))
        assert number(other.recv(TIMEOUT_S)) == 1
    with pytest.raises(can.CanInitializationError, match="3 bytes too long for a socket"):
        LocalBus(f"{tmp_path}/{'y' * (room + 3)}")


def test_directory_that_cannot_be_made():
    with pytest.raises(can.CanInitializationError, match="No such file or directory"):
        LocalBus("/nowhere/x")


def test_root_that_others_can_enter_is_refused(root):
    root.mkdir()
    root.chmod(0o755)
    with pytest.raises(can.CanInitializationError, match="must be a private directory"):
        LocalBus("x")


def test_root_without_a_runtime_directory(monkeypatch):
    for unusable in ("", "relative", "/nowhere"):
        monkeypatch.setenv("XDG_RUNTIME_DIR", unusable)
        assert local_bus.bus_root().name == f"can-rig-{os.getuid()}"
