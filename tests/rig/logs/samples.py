"""Logs to read: frames of every kind, what other programs write, and what formats keep of it."""

from pathlib import Path

import can
import numpy as np
from can import Message

from can_rig.logs.frames import ERROR, EXTENDED, Frames
from tests.rig.logs.candump_samples import rows

START_S = 1_700_000_000.25


def plain(count: int, start_s: float = START_S) -> list[Message]:
    """Classic data frames, one every 0.1 to 1 ms, of two buses."""
    random = np.random.default_rng(1)
    times = start_s + np.cumsum(random.integers(100, 1000, count)) * 1e-6
    extended = random.integers(0, 2, count)
    return [
        Message(
            timestamp=float(stamp),
            arbitration_id=int(random.integers(0, 1 << 29)) if extended[at] else at % 0x7FF,
            is_extended_id=bool(extended[at]),
            data=random.bytes(int(random.integers(0, 9))),
            channel=int(random.integers(0, 2)),
            is_rx=bool(at % 3),
        )
        for at, stamp in enumerate(times)
    ]


def kinds() -> list[Message]:
    """One frame of every kind."""
    common = {"channel": 1, "is_extended_id": False}
    return [
        Message(START_S, 0x123, data=b"\1\2\3", **common),
        Message(START_S + 0.001, 0x123, is_remote_frame=True, dlc=5, **common),
        Message(START_S + 0.002, 0x7FF, is_fd=True, data=bytes(range(48)), **common),
        Message(START_S + 0.003, 0x7FE, is_fd=True, bitrate_switch=True, data=b"\1", **common),
        Message(START_S + 0.004, is_error_frame=True, channel=1),
        Message(START_S + 0.005, 0x1234567, data=bytes(8), channel=1, is_rx=False),
    ]


def by_python_can(path: Path, messages: list[Message]) -> Path:
    with can.Logger(path) as logger:
        for message in messages:
            logger.on_message_received(message)
    return path


def content(frames: Frames) -> list[tuple]:
    """What every format keeps of a frame, buses by their numbers apart."""
    return [
        (0, flags & ~EXTENDED, *rest) if flags & ERROR else (identifier, flags, *rest)
        for _, identifier, flags, _, *rest in rows(frames)
    ]


def relative_ns(frames: Frames) -> np.ndarray:
    return frames.time_ns - frames.time_ns[0]


_FD = " 130000  130     {}000 0 0 0 0 0"
LOG2ASC = f"""\
date Fri Jul 10 06:17:32 2015
base hex  timestamps absolute
no internal events logged
   0.000000 1  44              Rx   d 5 2A 36 6C 2B BA
   0.400291 1  12345678x       Rx   r 0
   1.000857 CANFD   1 Rx        5A1                          0 0 0  0  {_FD.format(1)}
   1.201412 CANFD   1 Tx        5A1                          1 1 2 2 11 22 {_FD.format(7)}
   1.401516 1  ErrorFrame
"""
CANOE = """\
date Sam Sep 30 15:06:13.191 2017
base hex  timestamps absolute
internal events logged
// version 9.0.0
Begin Triggerblock Sat Sep 30 15:06:13.191 2017
   0.000000 Start of measurement
   0.015991 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0
   0.015991 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%
   1.000000 1  123             Rx   d 2 0A 0B  Length = 0 BitCount = 64 ID = 291
   2.501000 2  1F334455x       Tx   d 1 FF
   3.000000 J1939TP FEE3p 6 0 0 - Rx d 23 A0 0F A6 60 3B D1 40 1F DE 80 25 D0 07 60 27 00
   3.148421 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%
End TriggerBlock
"""
PEAK = """\
;$FILEVERSION=1.1
;$STARTTIME=43474.7110516666
;
;   Message Number
     1)      1059.9  Rx         0300  7  00 00 00 00 04 00 00
     2)      1065.5  Tx     00000300  8  00 00 00 00 00 00 00 01
     3)      1283.2  Warng  FFFFFFFF  4  00 00 00 04 -- -- -- -- BUSLIGHT
     4)      1298.9  Rx         0400  2  RTR
"""
GVRET = """\
Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
39747828,000005EB,false,Rx,0,8,E8,45,85,4B,4A,28,36,69,
39747900,18FEF100,true,Tx,1,3,01,02,03,00,00,00,00,00,
39748000,00000800,false,Rx,0,0,00,00,00,00,00,00,00,00,
"""
_SESSION = """\
***BUSMASTER Ver 2.0.0***
***PROTOCOL CAN***
***NOTE: PLEASE DO NOT EDIT THIS DOCUMENT***
***[START LOGGING SESSION]***
***START DATE AND TIME {date} 14:19:9:538***
***{base}***
***{mode} MODE***
***START CHANNEL BAUD RATE***
***CHANNEL 1 - Kvaser - Virtual #0 (Channel 0), Serial Number- 0, Firmware- 0x0 0x0 - 500000 bps***
***END CHANNEL BAUD RATE***
***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***
{frames}
***END DATE AND TIME {date} 14:19:24:103***
***[STOP LOGGING SESSION]***
"""
BUSMASTER_HEX = """\
14:19:11:4184 Tx 1 0x099 s 8 00 01 02 03 04 05 06 FF 
14:19:11:4174 Rx 2 0x18FEF100 x 2 0A 0B 
14:19:11:4190 Rx 2 0x100 sr 8 
14:19:11:419 Rx 2 100 xr 0 
"""  # noqa: W291 (as BUSMASTER writes it)
BUSMASTER_DEC = "00:00:01:0000 Rx 1 0255 s 3 000 255 016 "


def busmaster(
    base: str = "HEX", mode: str = "SYSTEM", frames: str = BUSMASTER_HEX, day: int = 20
) -> str:
    """A session as BUSMASTER records it."""
    return _SESSION.format(base=base, mode=mode, frames=frames, date=f"{day}:11:2013")
