"""Any frame of CAN and CAN FD, drawn by hypothesis."""

from collections.abc import Callable, Sequence

import can
from can.util import CAN_FD_DLC
from hypothesis import strategies as st


def any_bytes(size: int) -> st.SearchStrategy[bytes]:
    return st.binary(min_size=size, max_size=size)


@st.composite
def frames(
    draw: st.DrawFn,
    kinds: Sequence[str] = ("data", "remote", "fd"),
    payload: Callable[[int], st.SearchStrategy[bytes]] = any_bytes,
) -> can.Message:
    """A frame of one of ``kinds``, also "error"; ``payload`` draws its bytes by their number."""
    kind = draw(st.sampled_from(kinds))
    extended = draw(st.booleans())
    size = draw(st.sampled_from(CAN_FD_DLC) if kind == "fd" else st.integers(0, 8))
    return can.Message(
        arbitration_id=draw(st.integers(0, 0x1FFFFFFF if extended else 0x7FF)),
        is_extended_id=extended,
        is_remote_frame=kind == "remote",
        is_error_frame=kind == "error",
        is_fd=kind == "fd",
        bitrate_switch=kind == "fd" and draw(st.booleans()),
        error_state_indicator=kind == "fd" and draw(st.booleans()),
        dlc=size,
        data=b"" if kind == "remote" else draw(payload(size)),
        check=True,
    )
