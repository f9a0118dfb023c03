"""Signals of any log through any DBC: which are drawn, where, and with what beside the axes."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from can_rig.cli.plot import resolve
from can_rig.decoding.decode import Decoder, decode_log
from can_rig.drawing.thinning import MAX_POINTS, thinned
from can_rig.errors import DbcError
from can_rig.frames.databases import load_database
from can_rig.views.pictures import plot_page
from tests.helpers import DBC, asked, record, refused

CAR = """VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 256 ENGINE: 4 ECU
 SG_ Speed : 0|16@1+ (0.25,0) [0|16000] "rpm" ECU
 SG_ Temperature : 16|8@1+ (1,-40) [-40|215] "degC" ECU
 SG_ State : 24|2@1+ (1,0) [0|3] "" ECU
BO_ 257 WHEEL: 2 ECU
 SG_ Speed : 0|16@1+ (0.25,0) [0|16000] "rpm" ECU
VAL_ 256 State 0 "OFF" 1 "IDLE" 2 "RUN" ;
"""
PEAKS, LOW = st.floats(-1e6, 1e6), st.floats(-1, 1)
START_S = 1_700_000_000


@pytest.fixture
def car():
    Path("car.dbc").write_text(CAR)
    lines = [
        f"({START_S + at / 100:.6f}) can0 100#{4 * at:02X}0050{min(at // 20, 2):02X}\n"
        f"({START_S + at / 100:.6f}) can0 101#{2 * at:02X}00\n"
        for at in range(60)
    ]
    Path("car.log").write_text("".join(lines))
    return Path("car.log")


def test_any_dbc_any_log(car):
    """Also with dollars in a unit and in the words of a value, which begin no formula."""
    Path("car.dbc").write_text(CAR.replace('"rpm"', '"$/{$"').replace("IDLE", "$_{$"))
    wanted = ["ENGINE.Speed", "WHEEL.Speed", "Temperature", "State"]
    done = asked("plot", car, *wanted, "--dbc", "car.dbc")
    assert (done.returncode, done.stderr) == (0, "")
    assert Path("car.png").read_bytes().startswith(b"\x89PNG")
    for arguments, words in (
        (("State", "--dbc", "car.dbc"), "car.png: exists"),
        (("Temprature", "--dbc", "car.dbc", "--force"), "did you mean Temperature or"),
        (("Speed", "--dbc", "car.dbc", "--force"), "must be ENGINE.Speed or WHEEL.Speed"),
        (("State", "--dbc", "car.dbc", "--force", "--channel", "can9"), "the log has can0"),
        (("SteerTorque", "--force"), "no frame of STEER_TORQUE_CMD"),
        (("State", "--dbc", "away.dbc", "--force"), "cannot be read"),
        (("State", "--dbc", "car.dbc", "--out", "x.jpg"), "FILE.png, FILE.svg or FILE.pdf"),
    ):
        assert words in refused("plot", car, *arguments)


@pytest.mark.filterwarnings("error")
def test_one_panel_a_unit_words_on_the_axis_and_a_date(car):
    messages = decode_log(car, "car.dbc")
    pairs = [
        ("ENGINE", "Speed"), ("ENGINE", "State"), ("WHEEL", "Speed"), ("ENGINE", "Temperature"),
    ]  # fmt: skip
    page = plot_page(messages, pairs, START_S * 10**9)
    speeds, state, temperature = page.axes
    names = [[text.get_text() for text in axis.get_legend().get_texts()] for axis in page.axes]
    assert names == [
        ["ENGINE.Speed in rpm", "WHEEL.Speed in rpm"],
        ["State"],
        ["Temperature in degC"],
    ]
    assert [line.get_drawstyle() for line in speeds.get_lines()] == ["steps-post"] * 2
    np.testing.assert_allclose(speeds.get_lines()[0].get_ydata(), np.arange(60))
    np.testing.assert_allclose(speeds.get_lines()[0].get_xdata(), np.arange(60) / 100, atol=1e-9)
    assert [text.get_text() for text in state.get_yticklabels()] == [
        "OFF (0)",
        "IDLE (1)",
        "RUN (2)",
    ]
    assert temperature.get_xlabel() == "time in s since 2023-11-14 22:13:20 UTC"


def test_neither_words_nor_numbers_lie_upon_each_other(tmp_path):
    """Codes of a byte, close together and one far away; and numbers with a power of ten."""
    log, dbc = tmp_path / "a.log", tmp_path / "a.dbc"
    dbc.write_text(
        'BO_ 1 A: 8 X\n SG_ Gear : 0|8@1+ (1,0) [0|0] "" X\n'
        ' SG_ Count : 32|32@1+ (1,0) [0|0] "" X\n'
        'VAL_ 1 Gear 0 "P" 1 "R" 2 "N" 255 "not available" ;\n'
    )
    codes = [0, 255, 1, 2, *range(3, 20)]
    log.write_text(
        "".join(f"({code}.0) can0 001#{code:02X}0000000000{code:02X}40\n" for code in codes)
    )
    page = plot_page(decode_log(log, dbc), [("A", "Gear"), ("A", "Count")], 0)
    page.canvas.draw()
    gear, count = page.axes
    words = gear.get_yticklabels()
    assert [word.get_text() for word in words[:4]] == ["P (0)", "R (1)", "N (2)", "? (3)"]
    assert words[-1].get_text() == "not available (255)"
    boxes = [word.get_window_extent() for word in words]
    assert all(below.y1 <= above.y0 for below, above in pairwise(boxes))
    power = count.yaxis.get_offset_text()
    assert power.get_text() == "1e9"
    assert power.get_window_extent().x1 <= count.get_legend().get_window_extent().x0 + 1


def test_a_run_folder_has_its_own_dbc_and_fault(tmp_path):
    log, _, scenario = record(
        tmp_path,
        "duration_s=0.05",
        "fault.at_s=0.02",
        "disturbance={kind='gust', at_s=0.01, for_s=0.03, force_n=30}",
    )
    messages = decode_log(log, DBC / "steer_by_wire.dbc")
    page = plot_page(messages, [("DSTAR_FEEDBACK", "DStar")], 0, scenario)
    (axis,) = page.axes
    spans = [
        patch.get_extents().transformed(axis.transData.inverted()).intervalx
        for patch in axis.patches
    ]
    assert np.array(spans) == pytest.approx(np.array([[0.02, 0.049001], [0.01, 0.04]]))
    (said,) = (text.get_text() for text in axis.texts)
    assert said == "steering torque lost"
    bare = plot_page(messages, [("DSTAR_FEEDBACK", "DStar")], 0)
    assert not bare.axes[0].patches


@given(
    arrays(np.float64, st.integers(1, 90_001), elements=st.floats(-1e6, 1e6), fill=st.floats(-1, 1))
)
def test_a_long_signal_keeps_every_peak(values):
    time_s = np.arange(len(values)) * 1e-3
    thin_s, thin = thinned(time_s, values)
    assert len(thin) <= MAX_POINTS + MAX_POINTS // 2
    assert (thin.min(), thin.max()) == (values.min(), values.max())
    assert np.isin(thin_s, time_s).all()
    assert (np.diff(thin_s) > 0).all()


def test_names():
    messages = Decoder(load_database(DBC / "steer_by_wire.dbc")).messages
    assert resolve(messages, "DStar") == ("DSTAR_FEEDBACK", "DStar")
    assert resolve(messages, "CONTROLLER_STATUS.Tick") == ("CONTROLLER_STATUS", "Tick")
    with pytest.raises(DbcError, match="more than one message"):
        resolve(messages, "Tick")
    with pytest.raises(DbcError, match="did you mean DStar"):
        resolve(messages, "dstar")
    with pytest.raises(DbcError, match="it has VehicleSpeed, YawRate, "):
        resolve(messages, "qqqq")
