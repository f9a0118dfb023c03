"""The processor of nodes in lockstep: one core while they run, and afterwards all as before."""

import gc
import os

import pytest

from can_rig.nodes import scheduling
from can_rig.nodes.scheduling import one_core, preferred

CORES = {2, 5, 9}


class System:
    """What the system is asked and told."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.told: list[tuple[object, ...]] = []
        answers = {
            "sched_getaffinity": CORES,
            "sched_getscheduler": os.SCHED_OTHER,
            "sched_getparam": os.sched_param(0),
        }
        for name, answer in answers.items():  # of the asking process, number 0
            monkeypatch.setattr(os, name, {0: answer}.__getitem__)
        for name in ("sched_setaffinity", "sched_setscheduler"):
            monkeypatch.setattr(
                os, name, lambda *given, name=name: self.told.append((name, *given))
            )


@pytest.mark.parametrize(("pid", "core"), [(30, 2), (31, 5), (32, 9), (33, 2)])
def test_runs_side_by_side_get_different_cores(pid, core, monkeypatch):
    system = System(monkeypatch)
    monkeypatch.setattr(os, "getpid", lambda: pid)
    with pytest.raises(ZeroDivisionError), one_core():
        assert system.told == [
            ("sched_setaffinity", 0, {core}),
            ("sched_setscheduler", 0, os.SCHED_BATCH, os.sched_param(0)),
        ]
        system.told.clear()
        raise ZeroDivisionError
    assert system.told == [
        ("sched_setscheduler", 0, os.SCHED_OTHER, os.sched_param(0)),
        ("sched_setaffinity", 0, CORES),
    ]


def test_where_the_system_has_no_such_calls_nothing_is_done(monkeypatch):
    system = System(monkeypatch)
    monkeypatch.delattr(os, "sched_setaffinity")
    with one_core():
        assert system.told == []
    assert system.told == []


def test_what_takes_long_happens_without_the_priority(monkeypatch):
    """Another node of the same core would wait meanwhile: 59 ms without commands, once."""
    seen: list[object] = []
    monkeypatch.setattr(gc, "collect", lambda: seen.append("searched"))
    monkeypatch.setattr(scheduling, "_locked", lambda: seen.append("locked") or "memory locked")
    monkeypatch.setattr(os, "sched_setaffinity", lambda *_: None)
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda _, policy, at: seen.append((policy, at.sched_priority))
    )
    with pytest.raises(KeyError), preferred(0) as said:
        assert said.startswith("SCHED_FIFO 50; core ")
        assert seen == ["searched", "locked", (os.SCHED_FIFO, 50)]
        seen.clear()
        raise KeyError
    assert seen == [(os.SCHED_OTHER, 0)]
