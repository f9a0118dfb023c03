"""The drive that the tests of replay share."""

import pytest

from can_rig.logs.reading import read_log
from tests.helpers import record
from tests.rig.replay.drive import SETTINGS


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    log, _, _ = record(tmp_path_factory.mktemp("drive"), *SETTINGS)
    return log


@pytest.fixture(scope="module")
def frames(drive):
    return [message for chunk in read_log(drive) for message in chunk.messages()]
