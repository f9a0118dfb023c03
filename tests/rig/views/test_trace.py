"""Frames on a page: the bytes of the log, and the values that cantools finds in the bytes."""

import math
from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from playwright.sync_api import expect

from tests.browser import barriers
from tests.helpers import succeeded

DATABASE = """VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 256 INTEL: 8 ECU
 SG_ Odd : 3|13@1- (0.25,-7) [0|0] "rpm" ECU
 SG_ State : 16|2@1+ (1,0) [0|0] "" ECU
 SG_ Real : 32|32@1- (1,0) [0|0] "N.m" ECU
BO_ 2566844926 MOTOROLA: 8 ECU
 SG_ Big : 5|14@0- (2,1) [0|0] "" ECU
 SG_ Late : 39|24@0+ (0.5,0) [0|0] "m/s^2" ECU
BO_ 512 CHOSEN: 4 ECU
 SG_ Which M : 0|2@1+ (1,0) [0|0] "" ECU
 SG_ First m0 : 8|16@1+ (1,0) [0|0] "" ECU
 SG_ Second m1 : 8|8@1- (1,0) [0|0] "" ECU
BO_ 768 LONG: 8 ECU
 SG_ Whole : 0|64@1+ (1,0) [0|0] "" ECU
BO_ 769 SINGLE: 8 ECU
 SG_ Double : 7|64@0- (2,0) [0|0] "" ECU
VAL_ 256 State 0 "OFF" 1 "IDLE" 2 "RUN" ;
SIG_VALTYPE_ 256 Real : 1;
SIG_VALTYPE_ 769 Double : 2;
"""
IDENTIFIERS = {256: 8, 0x18FEF1FE: 8, 512: 4, 768: 8, 769: 8, 1000: 3}
VALUES = """(async () => {
  const { kinds, data, points } = run.frames, frames = framesOf(await unpacked(data), 0, points);
  const values = (f) => valuesOf(kinds[f.kind].signals, f.data);
  return frames.map((f) => ({
    time: f.time, identifier: kinds[f.kind].identifier, data: hex(f.data).join(""),
    values: values(f).map(({ name, value, word }) => [name, String(value), word]),
  }));
})()"""


@pytest.fixture
def log(tmp_path):
    """Random frames of every message of ``DATABASE``, of an unknown message, and special frames."""
    (tmp_path / "any.dbc").write_text(DATABASE)
    random, messages = np.random.default_rng(7), []
    for number in range(300):
        identifier = int(random.choice(list(IDENTIFIERS)))
        data = random.integers(0, 256, IDENTIFIERS[identifier], dtype=np.uint8).tobytes()
        messages.append(
            can.Message(
                timestamp=1000.0 + 0.125 * number,
                arbitration_id=identifier,
                is_extended_id=identifier > 0x7FF,
                data=data,
                channel="can1",
            )
        )
    messages.append(can.Message(timestamp=1100.0, arbitration_id=256, is_extended_id=False,
                                is_remote_frame=True, dlc=8, channel="can1"))  # fmt: skip
    with can.CanutilsLogWriter(str(tmp_path / "any.log")) as writer:
        for message in messages:
            writer.on_message_received(message)
    return tmp_path / "any.log", messages


def opened(page, path: Path, *arguments: object) -> None:
    succeeded("view", *arguments, "--out", path, "--force")
    page.goto(path.as_uri())
    page.wait_for_selector("body[data-drawn]")


def test_the_values_of_each_frame_are_those_of_cantools(page, log, tmp_path):
    path, messages = log
    opened(page, tmp_path / "any.html", path, "--dbc", tmp_path / "any.dbc")
    database = cantools.database.load_string(DATABASE, "dbc")
    shown = page.evaluate(VALUES)
    assert len(shown) == len(messages)
    for row, message in zip(shown, messages, strict=True):
        assert math.isclose(row["time"], message.timestamp - 1000.0, abs_tol=1e-6)
        assert int(row["identifier"], 16) == message.arbitration_id
        assert bytes.fromhex(row["data"]) == bytes(message.data)
        if message.arbitration_id == 1000 or message.is_remote_frame:
            assert row["values"] == []
            continue
        names = {name: (value, word) for name, value, word in row["values"]}
        layout = database.get_message_by_frame_id(message.arbitration_id)
        try:
            expected = layout.decode(bytes(message.data), decode_choices=False)
        except cantools.database.DecodeError:  # no signals for this value of the multiplexer
            assert set(names) == {"Which"}
            continue
        assert set(names) == set(expected)
        for name, value in expected.items():
            if isinstance(value, int):
                assert int(names[name][0]) == value
            else:
                said = float(names[name][0].replace("Infinity", "inf"))
                assert said == value or (math.isnan(said) and math.isnan(value))
        if "State" in expected:
            assert names["State"][1] == {0: "OFF", 1: "IDLE", 2: "RUN"}.get(expected["State"])


def test_a_filter_finds_messages_values_words_and_bytes(page, log, tmp_path):
    path, messages = log
    opened(page, tmp_path / "any.html", path, "--dbc", tmp_path / "any.dbc")
    page.click("#trace summary")
    intel = [m for m in messages if m.arbitration_id == 256 and not m.is_remote_frame]
    decoded = [cantools.database.load_string(DATABASE, "dbc").decode_message(256, m.data, False)
               for m in intel]  # fmt: skip
    low, *_, high = sorted(values["Odd"] for values in decoded)[3:-3]
    found = {
        "intel -remote": len(intel),
        "18fef1fe can1": sum(m.arbitration_id == 0x18FEF1FE for m in messages),
        "can2": 0,
        "state=run": sum(values["State"] == 2 for values in decoded),
        f"odd>{low} odd<={high}": sum(low < values["Odd"] <= high for values in decoded),
        f"odd>={low} odd<{high}": sum(low <= values["Odd"] < high for values in decoded),
        f"data={bytes(intel[3].data[2:5]).hex()}": sum(
            bytes(intel[3].data[2:5]) in bytes(m.data) for m in messages
        ),
        "": len(messages),
    }
    for text, count in found.items():
        page.fill("#trace input", text)
        expect(page.locator("#trace output")).to_have_text(f"{count} of {len(messages)} frames")
    page.fill("#trace input", "intel")
    page.click(".frames tbody tr >> nth=2")
    seconds = f"{intel[2].timestamp - 1000.0:.3f} s"
    current = page.locator(".frames tr[aria-current] td").first
    expect(current).to_have_text(seconds[:-2] + "000")
    assert barriers(page) == []
    page.focus(".frames")
    page.keyboard.press("ArrowDown")
    expect(current).to_have_text(f"{intel[3].timestamp - 1000.0:.6f}")


def test_frames_beyond_the_most_are_said_to_be_missing(page, log, tmp_path, monkeypatch):
    monkeypatch.setattr("can_rig.decoding.trace.MOST_FRAMES", 40)
    opened(page, tmp_path / "any.html", log[0], "--dbc", tmp_path / "any.dbc")
    expect(page.locator("#trace output")).to_have_text(
        "40 of 40 frames, the first until 4.875 s; --from shows later"
    )


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("two")
    for name, duration_s, at_s in (("a", 0.6, 0.2), ("b", 0.8, 0.3)):
        settings = "--set", f"duration_s={duration_s}", "--set", f"fault.at_s={at_s}"
        succeeded("run", "ideal", *settings, "--in-process", "--out", folder / name)
    return folder


def test_the_curves_of_a_second_run_are_its_own_and_dotted(page, runs, tmp_path):
    opened(page, tmp_path / "ab.html", runs / "a", runs / "b")
    drawn = page.evaluate("(async () => columns(run))()")
    for name, folder in (("", "a"), ("b:", "b")):
        table = np.genfromtxt(runs / folder / "signals.csv", delimiter=",", names=True)
        values = np.array(drawn[f"{name}command_2"], dtype=float)
        known = np.isin(np.round(drawn["time"], 9), np.round(table["time_s"], 9))
        assert np.array_equal(values[known], table["force_difference_n"].astype(np.float32))
        assert np.isnan(values[~known]).all()
    assert len(drawn["time"]) == 800
    track = page.evaluate("(async () => columns(run.scene))()")
    opened(page, tmp_path / "b.html", runs / "b")
    its = page.evaluate("(async () => columns(run.scene))()")
    same = [its["time"].index(time_s) for time_s in track["time"]]
    assert track["other_x"] == [its["x"][row] for row in same]
    assert track["other_y"] == [its["y"][row] for row in same]
    opened(page, tmp_path / "ab.html", runs / "a", runs / "b")
    lines = page.locator("figure >> nth=0").locator(".key path")
    dashes = {lines.nth(n).get_attribute("stroke-dasharray") for n in range(lines.count())}
    assert "2 3" in dashes
    events = page.locator("#marks").inner_text()
    assert "0.200 s fault begins" in events
    assert "0.300 s B: fault begins" in events
    page.click("#list button >> nth=0")
    expect(page.locator("figure:last-child .key path")).to_have_count(2)


def boxes(page) -> list[tuple[str, dict[str, float]]]:
    charts = page.locator(".chart")
    return [
        (charts.nth(n).locator("b").inner_text(), charts.nth(n).bounding_box())
        for n in range(charts.count())
    ]


def dragged(page, handle, x: float, y: float) -> None:
    box = handle.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(x, y, steps=4)
    page.mouse.up()


def test_charts_are_dragged_resized_and_come_back_by_name_and_from_a_file(page, runs, tmp_path):
    opened(page, tmp_path / "a.html", runs / "a")
    first = boxes(page)
    onto = first[2][1]
    dragged(page, page.locator(".chart b").first, onto["x"] + 300, onto["y"] + onto["height"] - 5)
    names = [name for name, _ in boxes(page)]
    assert names[:3] == [first[1][0], first[2][0], first[0][0]]

    for n in (0, 1):
        box = page.locator(".chart").nth(n).bounding_box()
        middle = page.locator("#charts").bounding_box()
        dragged(page, page.locator(".chart .corner").nth(n), middle["x"] + middle["width"] / 2,
                box["y"] + box["height"] + 40)  # fmt: skip
    left, right = (box for _, box in boxes(page)[:2])
    assert left["y"] == right["y"]
    assert abs(left["width"] - right["width"]) < 2
    assert right["x"] > left["x"] + left["width"] - 2
    assert left["height"] > first[1][1]["height"]
    page.focus(".chart >> nth=2")
    page.keyboard.press("Alt+ArrowDown")
    page.keyboard.press("Shift+ArrowUp")
    page.locator(".chart >> nth=0").locator(".key").nth(0).click()  # hidden, so not of the layout
    arranged = boxes(page)

    page.click(".layouts summary")
    page.fill("[aria-label='name of the layout']", "mine")
    page.click(".layouts >> text=Save")
    with page.expect_download() as download:
        page.click("text=Write a file")
    assert download.value.suggested_filename == "mine.json"
    download.value.save_as(tmp_path / "mine.json")
    page.click("text=As at first")
    assert [name for name, _ in boxes(page)] == [name for name, _ in first]

    page.reload()
    page.wait_for_selector("body[data-drawn]")
    page.click(".layouts summary")
    page.click(".layouts button:text-is('mine')")
    assert shape(boxes(page)) == shape(arranged)
    page.click("[aria-label='forget the layout mine']")
    expect(page.locator(".layouts .saved button")).to_have_count(0)
    page.click("text=As at first")
    page.set_input_files("[aria-label='file of a layout']", tmp_path / "mine.json")
    expect(page.locator(".chart b").first).to_have_text(arranged[0][0])
    assert shape(boxes(page)) == shape(arranged)

    for text in ("no JSON", "[]", '{"charts": [{"title": 1, "keys": 2}]}'):
        (tmp_path / "bad.json").write_text(text)
        page.set_input_files("[aria-label='file of a layout']", tmp_path / "bad.json")
        expect(page.locator(".layouts [role=status]")).to_have_text("not a layout of charts")
        assert shape(boxes(page)) == shape(arranged)
    (tmp_path / "other.json").write_text('{"charts": [{"title": "x", "keys": ["nothing"]}]}')
    page.set_input_files("[aria-label='file of a layout']", tmp_path / "other.json")
    expect(page.locator(".layouts [role=status]")).to_have_text("not in this run: nothing")


def shape(of: list[tuple[str, dict[str, float]]]) -> list[tuple[object, ...]]:
    return [(name, round(b["x"]), round(b["width"]), round(b["height"])) for name, b in of]
