"""The complete controller node in C, compiled for this machine and run in this process."""

from __future__ import annotations

import ctypes
from pathlib import Path

from can_rig.errors import ExportError
from can_rig.export.application import application
from can_rig.export.running.compiler import shared_library
from can_rig.export.running.ecu import COUNTS, MOST_SENT, SENT_BYTES, Sent, harness, sent
from can_rig.scenario.settings import Scenario


def host_library(scenario: Scenario) -> Path:
    """The controller node of ``scenario`` as a library.

    Raises:
        ExportError: no compiler, or a compiler error.
    """
    files = application(scenario)
    return shared_library(files | harness(files))


class HostEcu:
    """``harness.c`` in this process; see ``Ecu``.

    Args:
        library: of ``host_library``.

    Raises:
        ExportError: loading fails.
    """

    def __init__(self, library: Path) -> None:
        try:
            loaded = ctypes.CDLL(str(library))
        except OSError as error:
            raise ExportError(f"{library}: cannot be loaded: {error}") from None
        loaded.harness_size.restype = ctypes.c_size_t
        self._frame, self._counts = loaded.harness_frame, loaded.harness_counts
        self._frame.restype = ctypes.c_uint8
        self._receivers = int(loaded.harness_receivers())
        self._memory = ctypes.create_string_buffer(loaded.harness_size())
        self._sent = ctypes.create_string_buffer(MOST_SENT * SENT_BYTES)
        loaded.ecu_init(self._memory)

    def take(self, frame_id: int, data: bytes) -> Sent:
        """See ``Ecu``."""
        n = self._frame(self._memory, frame_id, len(data), data, self._sent)
        return sent(self._sent.raw, n)

    def counts(self) -> list[int]:
        """See ``Ecu``."""
        found = (ctypes.c_uint32 * (self._receivers * COUNTS))()
        self._counts(self._memory, found)
        return list(found)

    def close(self) -> None:
        """Nothing to do: the node ends with the process."""
