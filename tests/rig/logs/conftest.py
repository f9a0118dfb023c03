"""The tests of logs run in a time zone that is not UTC."""

import os
import time

import pytest


@pytest.fixture(autouse=True, scope="module")
def a_time_zone():
    """ASC has local time; a zone other than UTC shows a confusion of the two."""
    before = os.environ.get("TZ")
    os.environ["TZ"] = "America/St_Johns"
    time.tzset()
    yield
    if before is None:
        del os.environ["TZ"]
    else:
        os.environ["TZ"] = before
    time.tzset()
