"""tools/against_libraries: every difference has a reason, and a made difference is found."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from tests.rig.decoding.databases import FEATURES
from tests.rig.logs.candump_samples import written
from tests.rig.logs.messages import from_messages
from tests.rig.logs.samples import CANOE, LOG2ASC, PEAK, by_python_can, kinds, plain

TOOLS = Path(__file__).parents[3] / "tools"


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOLS))
    import against_libraries

    monkeypatch.setattr(against_libraries, "counts", Counter())
    return against_libraries


def test_logs_and_a_database(tool, tmp_path, monkeypatch):
    for suffix in (".asc", ".blf", ".log"):
        by_python_can(tmp_path / f"kinds{suffix}", kinds())
        by_python_can(tmp_path / f"plain{suffix}", plain(50))
    for name, text in (("a.asc", LOG2ASC), ("b.asc", CANOE), ("a.trc", PEAK), ("a.dbc", FEATURES)):
        written(tmp_path, text, name)
    monkeypatch.setattr("sys.argv", ["against_libraries", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        tool.main()
    assert ended.value.code == 0
    assert tool.counts["logs"] == 9
    assert tool.counts["frames"] > 150
    assert tool.counts["values"] > 10
    assert tool.counts["DIFFERENT"] == 0


@pytest.mark.parametrize(
    "change",
    [lambda frames: frames[1:], lambda frames: replace(frames, time_ns=frames.time_ns + 2000),
     lambda frames: replace(frames, arbitration_id=frames.arbitration_id ^ 1),
     lambda frames: replace(frames, flags=frames.flags ^ 64),
     lambda frames: replace(frames, data=frames.data ^ 1)],
)  # fmt: skip
def test_another_frame_is_found(tool, tmp_path, monkeypatch, change):
    messages = [message for message in plain(5) if message.dlc]
    path = by_python_can(tmp_path / "a.log", messages)
    monkeypatch.setattr(tool, "read_log", lambda _: [change(from_messages(messages))])
    tool.compare_log(path)
    assert tool.counts["DIFFERENT"]
