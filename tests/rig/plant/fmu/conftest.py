"""FMUs of the thesis's car, of FMI 2 and of FMI 3, built once."""

import gc
import tempfile

import numpy as np
import pytest

from can_rig.scenario.build import continuous_car
from can_rig.scenario.plant_settings import PlantSettings
from tests.rig.plant.fmu.building import COMPILER, build


@pytest.fixture(scope="session")
def cars(tmp_path_factory):
    """The FMU by version of FMI."""
    if COMPILER is None:
        pytest.skip("no C compiler")
    folder, car = tmp_path_factory.mktemp("cars"), continuous_car(PlantSettings())
    return {
        version: build(folder / f"car{version}.fmu", version, car.a, car.b, np.ravel(car.c))
        for version in (2, 3)
    }


@pytest.fixture(autouse=True)
def no_folder_stays(tmp_path, monkeypatch):
    """What an FMU is unpacked into is gone when nothing uses it any more."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield
    gc.collect()  # pytest keeps what was raised in a circle
    assert list(folder.iterdir()) == []
