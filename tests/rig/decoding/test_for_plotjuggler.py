"""MCAP and Parquet as PlotJuggler, Foxglove and pandas take them."""

import json
import math

import pandas as pd
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader

from tests.helpers import asked, succeeded
from tests.rig.decoding.databases import by_cantools

DBC = """\
VERSION ""
BU_: A
BO_ 256 SPEEDS: 8 A
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" A
 SG_ Left m0 : 8|16@1- (0.01,0) [0|0] "m/s" A
 SG_ Right m1 : 8|16@1- (0.01,0) [0|0] "m/s" A
 SG_ Ratio : 32|32@1- (1,0) [0|0] "" A
BO_ 257 STATE: 1 A
 SG_ Mode : 0|8@1+ (1,0) [0|0] "" A
SIG_VALTYPE_ 256 Ratio : 1;
VAL_ 257 Mode 0 "off" 1 "on \\"now\\"" ;
"""
DATE_S = 1_700_000_000


@pytest.fixture
def log(tmp_path):
    """Both pages of a message, a value that is no number, and a word with quotation marks."""
    (tmp_path / "car.dbc").write_text(DBC, "ascii")
    lines = []
    for at in range(40):
        ratio = "0000C07F" if at == 7 else "0000803F"  # nan; 1.0
        payload = f"{at % 2:02X}{at * 3:02X}{at % 5:02X}00{ratio}"
        lines.append(f"({DATE_S + at}.{at:06d}) can0 100#{payload}\n")
        lines.append(f"({DATE_S + at}.{at:06d}) can0 101#{at % 3:02X}\n")
    path = tmp_path / "car.log"
    path.write_text("".join(lines), "ascii")
    return path


def test_mcap_has_every_frame_as_json(log, tmp_path):
    out = tmp_path / "a.mcap"
    succeeded("decode", log, "--dbc", log.with_suffix(".dbc"), "--out", out)
    with out.open("rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages(log_time_order=False))
    wanted = [
        (
            time_ns,
            message.name,
            {key: value for key, value in values.items() if math.isfinite(value)},
        )
        for time_ns, message, values in by_cantools(log)
    ]
    assert [(m.log_time, channel.topic, json.loads(m.data)) for _, channel, m in found] == wanted
    assert {(c.message_encoding, s.encoding) for s, c, _ in found} == {("json", "jsonschema")}
    assert all(m.publish_time == m.log_time for _, _, m in found)
    schemas = {schema.name: json.loads(schema.data) for schema, _, _ in found}
    assert schemas["SPEEDS"]["type"] == "object"
    assert schemas["SPEEDS"]["properties"]["Left"] == {"type": "number", "description": "m/s"}
    assert schemas["STATE"]["properties"]["Mode"]["description"] == '0 off, 1 on "now"'
    assert schemas["STATE"]["properties"]["Mode"]["type"] == "integer"


def test_words_of_a_bus_of_its_own(log, tmp_path):
    out = tmp_path / "a.mcap"
    database = f"can0={log.with_suffix('.dbc')}"
    succeeded("decode", log, "--dbc", database, "--names", "--relative", "--out", out)
    with out.open("rb") as file:
        found = list(make_reader(file).iter_messages(topics=["can0/STATE"]))
    assert [json.loads(m.data)["Mode"] for _, _, m in found[:3]] == ["off", 'on "now"', "2"]
    assert found[0][2].log_time == 0
    assert json.loads(found[0][0].data)["properties"]["Mode"]["type"] == "string"


def test_parquet_and_mcap_name_their_series_alike(log, tmp_path):
    """PlotJuggler calls what is in an MCAP file topic/field; a Parquet file is a topic."""
    outputs = ("--out", tmp_path / "a.mcap", "--out", tmp_path / "a.parquet")
    asked("decode", log, "--dbc", log.with_suffix(".dbc"), *outputs)
    with (tmp_path / "a.mcap").open("rb") as file:
        series = {
            f"{channel.topic}/{field}"
            for _, channel, m in make_reader(file).iter_messages()
            for field in json.loads(m.data)
        }
    files = (tmp_path / "a.parquet").glob("*.parquet")
    columns = {f"{file.stem}/{name}" for file in files for name in pq.read_schema(file).names}
    assert series == columns - {"SPEEDS/time", "STATE/time"}
    assert "SPEEDS/Left" in series


def test_parquet_has_dates_that_pandas_knows(log, tmp_path):
    asked("decode", log, "--dbc", log.with_suffix(".dbc"), "--out", tmp_path / "a.parquet")
    path = tmp_path / "a.parquet" / "SPEEDS.parquet"
    table = pd.read_parquet(path)
    wanted = [time_ns for time_ns, message, _ in by_cantools(log) if message.name == "SPEEDS"]
    assert str(table["time"].dtype) == "datetime64[ns, UTC]"
    assert table["time"].astype("int64").tolist() == wanted
    assert table["Ratio"].dropna().tolist() == [1.0] * 39
    part = pd.read_parquet(path, columns=["time", "Left"])
    assert len(part.dropna()) == 20


def test_mcap_has_no_times_before_1970(tmp_path, log):
    from can_rig.decoding.decode import decode_log
    from can_rig.decoding.files import Contents, output
    from can_rig.errors import LogError

    columns = decode_log(log, log.with_suffix(".dbc"))
    columns["STATE"].time_ns[0] = -1
    with (
        pytest.raises(LogError, match="MCAP holds no times before 1970"),
        output(tmp_path / "b.mcap", Contents({}, 0, False), force=False) as out,
    ):
        out.write(columns)
    assert not (tmp_path / "b.mcap").exists()
