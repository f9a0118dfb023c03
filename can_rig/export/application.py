"""The whole controller node in C: the law, its constants, its frames and its receive rules."""

from __future__ import annotations

from typing import Final

from can_rig.drawing.names import Signal, names_of
from can_rig.errors import ExportError
from can_rig.export.constants import constants_header, constants_source
from can_rig.export.law import filled, law_files, support
from can_rig.export.speed_words import words
from can_rig.export.writing.c_text import comment
from can_rig.frames.codec import MessageCodec, RigLayout
from can_rig.frames.network import Network
from can_rig.scenario.build import dbc_of, network_of
from can_rig.scenario.driving import controls
from can_rig.scenario.settings import Scenario

POWERS: Final = str.maketrans({"²": "^2", "³": "^3"})
"""Units in ASCII, for compilers without Unicode."""

BY_HAND: Final = ("e2e.h", "e2e.c", "frames.h", "frames.c", "ecu.h", "ecu.c")


def application(scenario: Scenario) -> dict[str, str]:
    """Text by file name: everything except the CAN driver, which provides ``ecu_send``.

    Raises:
        ScenarioError: the design fails.
        ExportError: the law uses syntax outside the C subset, or the frames come from another
            database.
    """
    network = network_of(scenario)
    if not network.is_the_rigs:
        raise ExportError(
            f"network.dbc = {scenario.network.dbc!r}: must be left out, for the ECU in C has the "
            "rig's own frames; run --controller c runs the law in C on yours"
        )
    of, names = controls(scenario, network), names_of(scenario.plant)
    limits, blends = scenario.limits, of.schedule is not None
    precision = scenario.design.precision
    title = f"The constants of the controller of scenario {scenario.name}."
    of_speed = words(network.speed is not None, blends)
    zero = "0.0f" if precision == "float32" else "0.0"
    return {
        **law_files(precision, blends),
        "constants.h": constants_header(title, of.schedule),
        "constants.c": constants_source(of.table, title, of.schedule),
        "firmware.h": filled(
            support("firmware_speeds.h" if blends else "firmware.h"),
            speed=_signal(network.speed) if network.speed else "",
            scenario=scenario.name,
            tick=f"{scenario.tick_s * 1e3:g} ms",
            latency=_latency(scenario),
            command_1=_signal(network.command_1, names.command_1, limits.torque_nm),
            command_2=_signal(network.command_2, names.command_2, limits.force_difference_n),
            estimate=_signal(network.status, names.output._replace(name="")),
            reference=_signal(network.reference, names.output._replace(name="")),
            measurement=_signal(network.feedback, names.output),
        ),
        "firmware.c": support("firmware_speeds.c" if blends else "firmware.c"),
        **{name: filled(support(name), zero=zero, **of_speed) for name in BY_HAND},
        "network.c": _network_source(network, scenario),
    }


def _network_source(network: Network, scenario: Scenario) -> str:
    """``network.c``: the DBC's properties of each frame, and the period."""
    lines = [*comment(f"The frames of {dbc_of(scenario).name}."), '#include "ecu.h"', ""]
    lines.append(f"const uint32_t ecu_tick_us = {round(scenario.tick_s * 1e6)};")
    for codec in network.by_role:
        numbers = {
            "id": f"0x{codec.frame_id:X}",
            "data_id": f"0x{codec.data_id:X}",
            "lsb": repr(codec.lsb),
            "raw_minimum": str(codec.raw_minimum),
            "raw_maximum": str(codec.raw_maximum),
        }
        if codec.modes and isinstance(codec.layout, RigLayout):
            numbers["mode_shift"], numbers["fault_state_shift"] = map(str, codec.layout.shifts)
            numbers["verdict_bits"] = str(codec.layout.verdict_bits)
        lines += ["", *comment(f"{codec.name}: {_signal(codec)}")]
        lines.append(f"const struct frame frame_{codec.role} = {{")
        lines += [f"    .{name} = {value}," for name, value in numbers.items()]
        lines.append("};")
    return "\n".join(lines) + "\n"


def _signal(codec: MessageCodec, signal: Signal | None = None, limit: float | None = None) -> str:
    """Unit, meaning and range of a frame's only signal, for the plant.

    ``limit`` bounds a command, though the frame could express more.
    """
    unit, name = codec.unit, codec.signal_name
    if signal is not None:
        unit = signal.unit.translate(POWERS)
        name = f"{signal.name} ({name})" if signal.name else name
    most = codec.maximum if limit is None else min(limit, codec.maximum)
    least = codec.minimum if limit is None else max(-limit, codec.minimum)
    said = f"[{unit}] {name}" if unit else name
    return f"{said}, {least:.10g}..{most:.10g}, steps of {codec.lsb:g}".replace("*/", "* /")


def _latency(scenario: Scenario) -> str:
    n = scenario.latency_ticks
    if n == 0:
        return "at once"
    return f"{n} tick{'s' if n > 1 else ''} ({n * scenario.tick_s * 1e3:g} ms) later"
