"""A car's own log through the estimator, against the run that the log was made of."""

import shlex

import numpy as np
import pandas as pd
import pytest
from asammdf import MDF

import can_rig
from can_rig.errors import RigError, ScenarioError
from can_rig.scenario.log_signals import ROLES, unit_factor
from tests.helpers import refuses, succeeded
from tests.project.pages import blocks, command_lines
from tests.rig.replay.car import CAR, FOLDER, GAP_S, LOSS_S

LOG = FOLDER / "car.log.gz"
SENT = {"network.signals.torque": "", "network.signals.command_1": "EPS_REQUEST.Torque"}


@pytest.fixture(scope="module")
def measured():
    return can_rig.replay(LOG, CAR)


def test_a_dead_motor_shows_in_the_torque_as_sent_but_not_as_measured(measured):
    sent = can_rig.replay(LOG, CAR, SENT).signals
    before = sent.loc[1.0 : GAP_S[0], "fault_estimate_mps2"].abs().max()
    after = sent.loc[LOSS_S + 0.5 :, "fault_estimate_mps2"].abs().max()
    assert before < 0.15
    assert after > 0.5
    assert (sent.loc[LOSS_S:, "fault_state"] == 2).any()  # confirmed
    assert measured.signals.loc[LOSS_S + 0.5 :, "fault_estimate_mps2"].abs().max() < 0.15
    assert not (measured.signals["fault_state"] == 2).any()


def test_a_lateral_acceleration_of_the_other_direction_is_noted():
    """No line for the signs as they are."""
    written = [line for line in CAR.read_text("utf-8").splitlines() if "lateral_acc" in line]
    name = written[0].partition('"')[2].rpartition('"')[0]
    for factor, noted in ((1.0, False), (-1.0, True)):
        value = f'{{signal = "{name}", factor = {factor}}}'
        changed = f"network.signals.lateral_acceleration={value}"
        done = succeeded("replay", LOG, "--scenario", CAR, "--set", changed)
        assert ("have opposite signs" in done.stderr) == noted


def test_a_gap_is_hold_from_five_periods_on(measured):
    hold = measured.signals.index[measured.signals["mode"] == 2]
    assert hold[0] == pytest.approx(GAP_S[0] - 0.01 + 0.05, abs=0.011)
    assert hold[-1] == pytest.approx(GAP_S[1] - 0.01, abs=0.011)
    assert len(hold) == measured.summary["ticks_blind"] == round((hold[-1] - hold[0]) / 0.01) + 1


def test_a_tick_takes_the_last_sample_and_none_of_the_future(measured):
    """Against pandas' asof of the decoded frames."""
    frames = can_rig.decode(LOG, FOLDER / "car.dbc")["EPS_STATUS"]["MotorTorque"]
    start_s = can_rig.decode(LOG, FOLDER / "car.dbc")["MOTION"].index[0]
    for name in ("WHEELS", "DRIVES", "EPS_STATUS", "EPS_REQUEST"):
        start_s = min(start_s, can_rig.decode(LOG, FOLDER / "car.dbc")[name].index[0])
    ticks = pd.Index(measured.signals.index + start_s + 1e-7)  # float64 resolves 0.2 µs of a date
    expected = frames.asof(ticks).to_numpy()
    np.testing.assert_array_equal(measured.signals["measured_torque_nm"].to_numpy(), expected)


def test_csv_parquet_and_mf4_have_the_same_columns(measured, tmp_path):
    for suffix in ("csv", "parquet", "mf4", "png"):
        measured.save(tmp_path / f"car.{suffix}")
    csv = pd.read_csv(tmp_path / "car.csv")
    parquet = pd.read_parquet(tmp_path / "car.parquet")
    names = list(measured.signals.columns)
    assert list(csv.columns)[1:] == list(parquet.columns)[1:] == names
    with MDF(tmp_path / "car.mf4") as mf4:
        for name in names:
            column = measured.signals[name].to_numpy()
            channel = mf4.get(name)
            np.testing.assert_array_equal(channel.samples, column[np.isfinite(column)])
            np.testing.assert_allclose(csv[name], column, rtol=1e-12)
            np.testing.assert_array_equal(parquet[name].astype(float), column)
            assert channel.unit == measured.signals.attrs["units"][name]


@pytest.mark.parametrize(
    ("role", "unit", "factor"),
    [("yaw_rate", "deg/sec", np.pi / 180), ("yaw_rate", "°/s", np.pi / 180),
     ("yaw_rate", "Unit_DegreOfArcPerSeco", np.pi / 180), ("lateral_acceleration", "m/s^2", 1.0),
     ("lateral_acceleration", "m/s²", 1.0), ("lateral_acceleration", "m/s/s", 1.0),
     ("lateral_acceleration", "g", 9.80665), ("speed", "kph", 1 / 3.6), ("speed", "km/h", 1 / 3.6),
     ("torque", "N m", 1.0), ("torque", "N*m", 1.0), ("torque", "cNm", 0.01)],
)  # fmt: skip
def test_units_as_databases_spell_them(role, unit, factor):
    assert unit_factor(ROLES[role], unit, "here") == pytest.approx(factor)


@pytest.mark.parametrize(("unit", "said"), [("%", "unit '%'"), ("", "no unit")])
def test_an_unknown_unit_is_refused_with_those_that_are_known(unit, said):
    with pytest.raises(ScenarioError, match=f"^here: has {said}; must be .* unit = one of nm, "):
        unit_factor(ROLES["torque"], unit, "here")


KEY = "network.signals."
BAD = [
    ({KEY + "yaw_rate": "MOTION.YawRat"}, "did you mean YawRate?"),
    ({KEY + "yaw_rate": "MOTIN.YawRate"}, "did you mean MOTION?"),
    ({KEY + "yaw_rate": "YawRate"}, "must be Message.Signal"),
    ({KEY + "yaw_rate": ""}, "yaw_rate: must be set"), ({KEY + "speed": ""}, "speed: must be set"),
    ({KEY + "lateral_acceleration": ""}, "lateral_acceleration: must be set"),
    ({KEY + "torque": ""}, "torque: must be set"), ({KEY + "torque": []}, "at least one signal"),
    ({KEY + "torque": 3}, "must be"), ({KEY + "torque": [3]}, "must be"),
    ({KEY + "torque": ["EPS_STATUS.MotorTorque", "EPS_STATUS.Other"]}, "has no signal Other"),
    ({KEY + "torque.bus": "can7"}, "no frame is of bus can7"),
    ({KEY + "torque.bus": "can0"}, "has no frame of EPS_STATUS on bus can0"),
    ({KEY + "torque.bus": 0}, "must be a text"),
    ({KEY + "torque.unit": "%"}, "has unit '%'; must be"),
    ({KEY + "torque.unit": "m/s"}, "has unit 'm/s'; must be"),
    ({KEY + "torque.unt": "Nm"}, "unknown key"), ({KEY + "torque.factor": 0}, "must not be 0"),
    ({KEY + "torque.factor": True}, "must be a number"),
    ({KEY + "torque.factor": "2 Nm"}, "must be a number"),
    ({KEY + "torque.offset": "x"}, "must be a number"),
    ({KEY + "torque.sign": "MOTION.YawRate"}, "must be a signal of EPS_STATUS"),
    ({KEY + "torque.sign": "EPS_STATUS.Sign"}, "has no signal Sign"),
    ({KEY + "torque.sign": "Sign"}, "must be Message.Signal"),
    ({KEY + "speed": "MOTION.YawRate"}, "has unit 'deg/s'; must be"),
    ({KEY + "feedback": "WHEELS.Speed"}, "has unit 'km/h'; must be"),
    ({KEY + "reference": "MOTION.Reference"}, "has no signal Reference"),
    ({KEY + "force_difference": "EPS_STATUS.MotorTorque"}, "has unit 'Nm'; must be"),
    ({KEY + "yaw": "MOTION.YawRate"}, "unknown key"),
    ({KEY + "speed": [{"signal": "WHEELS.Speed", "factor": 100.0}]}, "reaches 1000 m/s"),
    ({KEY + "speed": [{"signal": "WHEELS.Speed", "factor": 0.01}]}, "reaches 0.1 m/s"),
    ({"network.dbc": "absent.dbc"}, "absent.dbc"), ({"network.dbc": ""}, "must name the database"),
    ({"network.tick": "Tick"}, "signals: must be set beside network.tick"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "said"), BAD)
def test_bad_signals_are_one_line(changes, said):
    with refuses(said, RigError):
        can_rig.replay(LOG, CAR, changes)


@pytest.mark.parametrize(
    ("options", "said"),
    [({"max_age_s": 0.0}, "must be above 0"), ({"max_age_s": float("nan")}, "must be above 0"),
     ({"dbc": "absent.dbc"}, "absent.dbc"), ({"dbc": {"can1": "absent.dbc"}}, "absent.dbc"),
     ({"from_s": 4.05, "to_s": 4.3}, "has no frame of MOTION"), ({"from_s": 100.0}, "no frame")],
)  # fmt: skip
def test_bad_options_are_one_line(options, said):
    with refuses(said, RigError):
        can_rig.replay(LOG, CAR, **options)  # type: ignore[arg-type]


def lines_of(*, back_s: float = 0.0, apart_s: float = 0.0, twice: bool = False) -> str:
    """A candump log of the roles; times that go back, inputs apart in time, a second bus."""
    text = []
    for tick in range(200):
        at_s = 1000.0 + 0.01 * tick - back_s * (tick > 100)
        text.append(f"({at_s:.6f}) can0 101#0000000000000000")
        text.append(f"({at_s:.6f}) can0 102#0E10000000000000")
        text.append(f"({at_s:.6f}) can0 103#0000000000000000")
        text.append(f"({at_s + apart_s:.6f}) can1 201#0000000000000000")
        if twice:
            text.append(f"({at_s:.6f}) can2 101#0000000000000000")
    return "\n".join(text) + "\n"


@pytest.mark.parametrize(
    ("log", "said"),
    [
        (lines_of(back_s=5.0), "go back by"),
        (lines_of(apart_s=50.0), "no tick has all of its inputs: MOTION.YawRate from 0.000"),
        (lines_of(twice=True), "is on buses can0, can2"),
    ],
)
def test_logs_that_cannot_serve_are_one_line(log, said, tmp_path):
    path = tmp_path / "car.log"
    path.write_text(log)
    with pytest.raises(RigError, match=said):
        can_rig.replay(path, CAR)


def test_the_page_runs_as_printed(tmp_path):
    page = (FOLDER.parent / "recorded-drives.md").read_text("utf-8")
    (tmp_path / "docs").symlink_to(FOLDER.parent)
    for line in command_lines(page):
        succeeded(*shlex.split(line)[1:])
    assert (tmp_path / "car.png").stat().st_size > 10_000
    exec(blocks(page, "python")[0], {})
