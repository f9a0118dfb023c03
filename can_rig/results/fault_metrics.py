"""What each fault of a run did, beside the same run without this one fault."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from can_rig.drawing.fault_words import fault_in_words
from can_rig.drawing.names import names_of, with_unit
from can_rig.results.counterfactual import deviation_from, without_fault
from can_rig.results.loss_metrics import detection_of, unavoidable_deviation
from can_rig.results.metrics import absolute_error, peak_of, windows
from can_rig.results.signals import Signals
from can_rig.scenario.settings import Scenario


def fault_metrics(scenario: Scenario, signals: Signals) -> list[dict[str, Any]]:
    """A table for each fault, in the order of the scenario; None where the run has no such moment.

    A deviation is from the same run without this one fault, so that what others do beside it is in
    both. ``settled`` is the end of its time, or of the run, as in ``metrics``.
    """
    return [_of(scenario, signals, at) for at in range(len(scenario.faults))]


def fault_rows(scenario: Scenario, faults: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """A line of the closing table for each of several faults, label and text."""
    if len(faults) < 2:
        return []
    names = names_of(scenario.plant)
    end_s = scenario.ticks * scenario.tick_s
    return [
        (fault_in_words(fault, names, end_s), _said(values, names.output.unit))
        for fault, values in zip(scenario.faults, faults, strict=True)
    ]


def _said(values: dict[str, Any], unit: str) -> str:
    peak, delay_s = values["deviation_peak_mps2"], values["detection_delay_s"]
    parts = [] if peak is None else [f"deviation up to {with_unit(f'{peak:.4g}', unit)}"]
    parts += [] if delay_s is None else [f"confirmed after {delay_s:.4g} s"]
    parts += ["missed"] if values["missed_detection"] else []
    return ", ".join(parts) or "nothing"


def _of(scenario: Scenario, signals: Signals, at: int) -> dict[str, Any]:
    fault = scenario.faults[at]
    alone = replace(scenario, fault=(fault,))
    window = windows(alone, signals)
    values: dict[str, Any] = {
        "kind": fault.kind,
        "place": fault.place,
        "at_s": fault.at_s,
        "for_s": fault.for_s,
    }
    error = deviation = absolute_error(scenario, signals)
    if window.after.any():
        deviation = deviation_from(scenario, signals, without_fault(scenario, at, signals))
    values |= {
        "deviation_peak_mps2": peak_of(deviation[window.after]),
        "deviation_settled_mps2": peak_of(deviation[window.settled_after]),
        "error_peak_mps2": peak_of(error[window.active]),
        "fault_estimate_peak_mps2": peak_of(np.abs(signals.fault_estimate_mps2)[window.active]),
    }
    bound = unavoidable_deviation(scenario, signals, fault)
    values["unavoidable_deviation_mps2"] = None if bound is None else bound.deviation_mps2
    return values | detection_of(scenario, signals, at)._asdict()
