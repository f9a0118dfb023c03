"""The drive that the tests of replay share."""

from __future__ import annotations

from pathlib import Path

import pytest
from can import Message

from can_rig.results.signals import data_frames
from tests.helpers import record
from tests.rig.replay.drive import SETTINGS


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    log, _, _ = record(tmp_path_factory.mktemp("drive"), *SETTINGS)
    return log


@pytest.fixture(scope="module")
def frames(drive: Path) -> list[Message]:
    return list(data_frames(drive))
