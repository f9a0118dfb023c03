"""A fault or a disturbance in a few words, for titles, tables and reports."""

from __future__ import annotations

from typing import Final

from can_rig.drawing.names import Names, ticks_text, with_unit
from can_rig.scenario.disturbance_settings import DisturbanceSettings
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
    every = f", every {ticks_text(fault.every)}" if fault.every > 1 else ""
    when = _when(fault, every, end_s)
    if fault.kind == "sensor-biased":
        return f"{fault_label(fault, names)} {_size(fault, names)} {when}"
    size = _size(fault, names)
    told = f"{fault_label(fault, names)} {size}".rstrip()
    return f"{told} {when} ({fault.kind.replace('-', ' ')})"


def disturbance_label(disturbance: DisturbanceSettings) -> str:
    """Short description of ``disturbance``: kind and size."""
    of = disturbance
    if of.kind == "friction":
        axles = (("front", of.front), ("rear", of.rear))
        named = [f"{name} axle {factor:g}" for name, factor in axles if factor is not None]
        return f"friction factor of the {' and the '.join(named)}"
    words = {
        "gust": ("gust of", of.force_n, "N"),
        "turbulence": ("turbulence of", of.intensity_n, "N rms"),
        "bank": ("road banked by", of.bank_percent, "%"),
        "steering-kick": ("steering kick of", of.torque_nm, "N m"),
    }
    what, size, unit = words[of.kind]
    return f"{what} {size:g} {unit}"


def disturbance_in_words(disturbance: DisturbanceSettings, end_s: float) -> str:
    """Description of ``disturbance``: kind, size and time, for a run that ends at ``end_s``."""
    return f"{disturbance_label(disturbance)} {_when(disturbance, '', end_s)}"


def _when(what: FaultSettings | DisturbanceSettings, every: str, end_s: float) -> str:
    """The time of a fault or a disturbance."""
    when = f"{'at' if isinstance(what, FaultSettings) else 'from'} {what.at_s:g} s"
    if what.for_s is not None:
        when = f"from {what.at_s:g} s to {what.at_s + what.for_s:g} s"
    return when + every + (", after the end of the run" if what.at_s >= end_s else "")


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
