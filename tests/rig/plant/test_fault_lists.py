"""Any list of faults: the run on a bus is the loop without frames, bit for bit."""

import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.logs.columns import ON_THE_BUS
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.runner import run_in_process
from can_rig.nodes.without_bus import run_without_bus
from can_rig.results.counterfactual import signals_without_log
from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.fault_settings import PLACES, FaultKind
from tests.rig.plant.fault_settings import fault_list

KINDS = [kind for kind in FaultKind.__args__ if kind != "none"]
PLANT = "can_rig.plant.nonlinear_car:NonlinearCar"


def drawn(seed: int) -> list[str]:
    """Up to four faults with every key drawn, in 0.2 s."""
    draw = np.random.default_rng(seed)
    settings = ["duration_s=0.2", f"seed={seed}", "reference.kind=sine"]
    settings += ["reference.frequency_rad_per_s=30", f"latency_ticks={draw.integers(3)}"]
    settings += [f"actuator.hold_s={draw.integers(20) / 1000}"]
    settings += ["plant.torque_actuator.rate_nm_per_s=20000"] if seed % 3 == 0 else []
    settings += [f"plant.kind={PLANT}"] if seed % 4 == 0 else []
    faults: list[dict[str, object]] = []
    for at in range(int(draw.integers(1, 5))):
        kind = str(draw.choice(KINDS)) if at else KINDS[seed % len(KINDS)]
        places = PLACES if kind.startswith("frames-") else PLACES[:2]
        values = {
            "kind": kind,
            "channel": str(draw.choice(places)),
            "at_s": int(draw.integers(150)) / 1000,
            "for_s": int(draw.integers(1, 150)) / 1000,
            "every": int(draw.choice([1, 1, 1, 2, 7])),
            "left": int(draw.integers(10)) / 10,
            "bias_mps2": 0.05,
            "offset": float(draw.normal()),
            "drift_per_s": float(10 * draw.normal()),
            "amplitude": float(draw.normal()),
            "rate_per_s": float(draw.uniform(0.1, 300)),
            "late_ticks": int(draw.integers(1, 30)),
        }
        if draw.random() < 0.5 or kind == "frames-forged":
            values["value"] = float(draw.normal())
        faults.append(values)
    return settings + fault_list(*faults)


@pytest.mark.parametrize("seed", range(24))
def test_the_loop_without_frames_is_the_run_on_a_bus(seed, tmp_path):
    scenario = load("noisy" if seed % 2 else "ideal", drawn(seed))
    log = tmp_path / "bus.log"
    run_in_process(scenario, f"virtual:faults-{seed}", log, StopRequest(), lambda _: None)
    bus = read_signals(log, network_of(scenario), scenario.tick_s)
    loop = signals_without_log(scenario)
    for name in ON_THE_BUS:
        np.testing.assert_array_equal(getattr(bus, name), getattr(loop, name), name)
    assert all(np.isfinite(bus.fault_estimate_mps2))
    if not any(fault.adds_frames for fault in scenario.faults):
        other = tmp_path / "other.log"
        run_without_bus(scenario, other, StopRequest(), lambda _: None)
        assert other.read_bytes() == log.read_bytes()


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_changes_the_run(kind):
    needed = ["fault.value=0.5", "fault.offset=1", "fault.drift_per_s=9", "fault.amplitude=1"]
    settings = ["duration_s=0.1", "reference.kind=sine", "fault.rate_per_s=1", *needed]
    scenario = load("ideal", [*settings, f"fault.kind={kind}", "fault.at_s=0.05"])
    faulty, healthy = (signals_without_log(each) for each in (scenario, scenario.healthy))
    assert not np.array_equal(faulty.plant["true_dstar_mps2"], healthy.plant["true_dstar_mps2"])
