"""The controller as an FMU: its signals, or the node with its frames on a bus."""

from typing import Final
from xml.etree import ElementTree as Xml

from can_rig.drawing.names import names_of
from can_rig.export.application import BY_HAND, application
from can_rig.export.c_files import plain
from can_rig.export.fmu import TICKS, Model, Variable, as_text, name_of
from can_rig.export.law import NODE, numbers_of, parts_of, support
from can_rig.export.network_code import sensors_of
from can_rig.frames.codec import AGE
from can_rig.scenario.build import network_of
from can_rig.scenario.sensor_settings import HEARD, USUAL
from can_rig.scenario.settings import Scenario

OF_THE_NODE: Final = {
    name for name in (*BY_HAND, "network.c") if name.startswith(("e2e", "frames", "ecu", "network"))
}
"""Files of an application that a controller without frames does not need."""

CODES: Final = ("mode", "fault_state", "verdict")
CAN: Final = 'application/org.fmi-standard.fmi-ls-bus.can; version="1.0.0"'


def controller_model(scenario: Scenario) -> Model:
    """The controller of ``scenario``; inputs of further sensors have the names of their columns.

    Raises:
        ScenarioError, ExportError: as ``application``.
    """
    node = application(scenario)
    output, command_1, command_2 = names = names_of(scenario.plant)
    heard = sorted(number for number, _, _ in sensors_of(scenario, network_of(scenario)))
    speed = repr(scenario.model.speed_mps)
    inputs = [
        Variable("reference", "input", f"wanted {output.name}", output.unit, "0"),
        Variable("measurement", "input", output.name, output.unit, "0"),
    ]
    if scenario.drive.is_given:
        inputs.append(Variable("speed_mps", "input", "speed of the car", "m/s", speed))
    first_sample = 1 + len(inputs)
    for number in heard:
        measured = HEARD[number - 1]
        column, signal = USUAL[measured].column, names.at(measured)
        inputs.append(Variable(column, "input", signal.name, signal.unit, "0"))
        inputs.append(Variable(column + AGE, "input", TICKS, start="-1"))
    outputs = [
        Variable("command_1", "output", command_1.name, command_1.unit),
        Variable("command_2", "output", command_2.name, command_2.unit),
        Variable("fault_estimate", "output", "fault estimate", output.unit),
        *(Variable(code, "output", code.replace("_", " "), kind="Integer") for code in CODES),
    ]
    sources = {file: text for file, text in node.items() if file not in OF_THE_NODE}
    parts = parts_of(node) - {NODE}
    sources["fmu_controller.c"] = support(
        "fmu_controller.c",
        parts,
        scenario=scenario.name,
        tick=f"{scenario.tick_s * 1e3:g} ms",
        sensors=str(len(heard)),
        speed_mps=speed,
        first_sample=str(first_sample),
        numbers=", ".join(f"{number}.0f" for number in heard),
        **numbers_of(scenario.design.precision),
    )
    name = name_of("controller", scenario)
    words = f"The controller of scenario {scenario.name}"
    return Model(name, words, scenario, sources, parts, (*inputs, *outputs))


def node_model(scenario: Scenario) -> Model:
    """The controller as a node on a CAN bus: FMI-LS-BUS 1.0, network abstraction.

    Raises:
        ScenarioError, ExportError: as ``application``.
    """
    sources = application(scenario)
    parts = parts_of(sources)
    texts = {"scenario": plain(scenario.name), "bit_rate": str(scenario.bus.bitrate or 0)}
    sources |= {file: support(file, parts, **texts) for file in ("bus_node.h", "bus_node.c")}
    clock = {"intervalVariability": "triggered"}
    rx, tx = ({"mimeType": CAN, "clocks": reference} for reference in ("2", "4"))
    variables = [
        Variable("rx_data", "input", "bus operations", kind="Binary", attributes=rx),
        Variable("rx_clock", "input", "received", kind="Clock", attributes=clock),
        Variable("tx_data", "output", "bus operations", kind="Binary", attributes=tx),
        Variable("tx_clock", "output", "sent", kind="Clock", attributes=clock),
    ]
    root = Xml.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    terminal = Xml.SubElement(
        Xml.SubElement(root, "Terminals"), "Terminal", name="CAN",
        terminalKind="org.fmi-ls-bus.network-terminal", matchingRule="org.fmi-ls-bus.transceiver",
    )  # fmt: skip
    for each in variables:
        Xml.SubElement(
            terminal, "TerminalMemberVariable", variableKind="signal", variableName=each.name,
            memberName=each.name.title(),
        )  # fmt: skip
    return Model(
        name_of("node", scenario),
        f"The controller node of scenario {scenario.name} on its CAN bus",
        scenario,
        sources,
        parts,
        variables,
        {
            "terminalsAndIcons/terminalsAndIcons.xml": as_text(root),
            "extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml": _manifest(),
        },
    )


def _manifest() -> str:
    space = "http://fmi-standard.org/fmi-ls-manifest"
    Xml.register_namespace("fmi-ls", space)
    said = {
        "name": "org.fmi-standard.fmi-ls-bus", "version": "1.0.0",
        "description": "Layered standard for network communication",
    }  # fmt: skip
    attributes = {f"{{{space}}}fmi-ls-{key}": value for key, value in said.items()}
    attributes["isBusSimulationFMU"] = "false"
    return as_text(Xml.Element("fmiLayeredStandardManifest", attributes))
