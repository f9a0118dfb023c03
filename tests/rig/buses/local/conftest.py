"""Every test has local buses of its own."""

import pytest

from can_rig.buses.local import bus as local_bus


@pytest.fixture(autouse=True)
def root(tmp_path, monkeypatch):
    """Buses of a test, and of the processes that it starts, are its own."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(local_bus, "_SHUTDOWN_S", 0.2)
    return tmp_path / "can-rig"
