"""Traces of CARBUS Analyzer and logs of Microchip's analyzer, as SavvyCAN reads and writes them."""

import gzip

import pytest

from can_rig.errors import LogError
from can_rig.logs.frames import EXTENDED, FD, REMOTE, SENT, concatenate
from can_rig.logs.reading import content_format, read_log
from tests.rig.logs.candump_samples import rows, whole, written

CARBUS = (
    "@ TEXT @ {version} @ 64 @ 0 @ 4 @ 2 @ 00:00:00.002 @\r"
    "# $LocalTime=17:42:06.357\r"
    "46,{first}\t1\t0004\t45A\t3\t5A 04 FF               \t00000000\tZ       \t\r"
    "46,{second}\t2\t00000005\t1B000067\t8\t67 00 04 01 00 00 10 00\t00000000\tg       \t\r"
    "47,0\t1\t0004\t800\t0\t                       \t00000000\t        \t\r"  # SavvyCAN has 0004
    "47,1\t1\t0004\t123\t4\t                       \t00000000\t        \t\r"
    "47,2\t1\t0004\t7FF\t12\t" + "0A " * 12 + "\t00000000\t        \t\r"
)
MICROCHIP_LOG = """\
//---------------------------------
Microchip Technology Inc.
CAN BUS Analyzer
SavvyCAN Exporter
Logging Started: 23/9/2015 22:17:43
//---------------------------------
166064;RX;0x0000021A;8;0xFE;0x36;0x12;0xFE;0x69;0x05;0x07;0xAD;
166074;TX;0x00000800;2;0x01;0x0F;
1660740;RX;0x236;1;0x1C;0x00;0x00
1660741;RX;0x18FEF100;0;
"""


@pytest.mark.parametrize(("version", "unit_ns"), [(2, 1_000_000), (3, 1_000)])
def test_a_trace_of_carbus_analyzer(tmp_path, version, unit_ns):
    """Seconds and a number of ms or of µs, which may lack its leading zeros."""
    text = CARBUS.format(version=version, first="016", second="21")
    ten = 10**9
    for name, content in (("a.trc", text), ("b.trc", text.replace("\r", "\r\n"))):
        log = read_log(written(tmp_path, content, name), chunk_frames=2)
        assert rows(concatenate(log)) == [
            (46 * ten + 16 * unit_ns, 0x45A, 0, "1", 3, b"\x5a\4\xff"),
            (46 * ten + 21 * unit_ns, 0x1B000067, EXTENDED, "2", 8, b"\x67\0\4\1\0\0\x10"),
            (47 * ten, 0x800, EXTENDED, "1", 0, b""),
            (47 * ten + unit_ns, 0x123, REMOTE, "1", 4, b""),
            (47 * ten + 2 * unit_ns, 0x7FF, FD, "1", 12, b"\x0a" * 12),
        ]  # fmt: skip
        assert log.start_ns == 46 * ten + 16 * unit_ns
        assert log.notice is None


def test_a_microchip_log(tmp_path):
    path = written(tmp_path, MICROCHIP_LOG, "a.log")
    assert content_format(path).key == "Microchip"
    expected = [
        (166_064_000_000, 0x21A, 0, "0", 8, bytes.fromhex("FE3612FE690507AD")),
        (166_074_000_000, 0x800, EXTENDED | SENT, "0", 2, b"\1\x0f"),
        (1_660_740_000_000, 0x236, 0, "0", 1, b"\x1c"),
        (1_660_741_000_000, 0x18FEF100, EXTENDED, "0", 0, b""),
    ]
    assert rows(whole(path, 1)) == expected
    bare = written(tmp_path, MICROCHIP_LOG[MICROCHIP_LOG.index("166064") :], "b.log")
    assert rows(whole(bare)) == expected
    packed = written(tmp_path, gzip.compress(MICROCHIP_LOG.encode()), "c.log.gz")
    assert rows(whole(packed)) == expected


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (MICROCHIP_LOG.replace("0x69", "0x6G"), 7),
        (MICROCHIP_LOG.replace("TX;0x00000800;2", "TX;0x00000800;3"), 8),
        (MICROCHIP_LOG.replace("0x18FEF100", "0x38FEF100"), 10),
        (CARBUS.format(version=2, first="016", second="1016"), 4),
        (CARBUS.format(version=3, first="016", second="21").replace("5A 04 FF", "5A 04 XX"), 3),
    ],
)
def test_a_damaged_frame_is_named(tmp_path, text, line):
    with pytest.raises(LogError, match=rf"a.log: line {line}: not a valid frame"):
        whole(written(tmp_path, text, "a.log"))
