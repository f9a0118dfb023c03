"""A fault in a few words, for titles, tables and reports."""

from __future__ import annotations

from typing import Final

from can_rig.drawing.names import Names, ticks_text, with_unit
from can_rig.scenario.fault_settings import FaultSettings

HOW: Final = {
    "actuator-dead": "lost",
    "sensor-dead": "lost",
    "frames-missing": "lost",
    "frames-corrupted": "lost",
    "sensor-biased": "biased",
    "actuator-drift": "drifting",
    "sensor-drift": "drifting",
}
"""Exceptions to the last part of the kind."""


def fault_label(fault: FaultSettings, names: Names) -> str:
    """Short description of ``fault``."""
    share = f"{100.0 * (1.0 - fault.left):g} % of " if fault.left and "dead" in fault.kind else ""
    how = HOW.get(fault.kind) or fault.kind.partition("-")[2].replace("-", " ")
    return f"{share}{names.hit_by(fault).name} {how}"


def fault_in_words(fault: FaultSettings, names: Names, end_s: float) -> str:
    """Description of ``fault``: kind, size and time, for a run that ends at ``end_s``."""
    when = f"at {fault.at_s:g} s"
    if fault.for_s is not None:
        when = f"from {fault.at_s:g} s to {fault.at_s + fault.for_s:g} s"
    if fault.every > 1:
        when += f", every {ticks_text(fault.every)}"
    if fault.at_s >= end_s:
        when += ", after the end of the run"
    if fault.kind == "sensor-biased":
        return f"{fault_label(fault, names)} {_size(fault, names)} {when}"
    size = _size(fault, names)
    told = f"{fault_label(fault, names)} {size}".rstrip()
    return f"{told} {when} ({fault.kind.replace('-', ' ')})"


def _size(fault: FaultSettings, names: Names) -> str:
    """By how much, where a key of the fault says so."""
    unit = names.hit_by(fault).unit
    a_second = f"{unit}/s".lstrip()
    sizes = {
        "biased": ("by", fault.bias_mps2, unit),
        "offset": ("by", fault.offset, unit),
        "drift": ("by", fault.drift_per_s, a_second),
        "oscillating": ("by", fault.amplitude, unit),
        "limited": ("to", fault.rate_per_s, a_second),
        "stuck": ("at", fault.value, unit),
        "forged": ("as", fault.value, unit),
    }
    if fault.kind.endswith("-late"):
        return f"by {ticks_text(fault.late_ticks)}"
    word, value, its_unit = sizes.get(fault.kind.rpartition("-")[2], ("", None, ""))
    return "" if value is None else f"{word} {with_unit(f'{value:g}', its_unit)}"
