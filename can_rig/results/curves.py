"""Curves and charts of a run, as the bench shows them, live and recorded."""

from collections.abc import Mapping
from typing import Final

from can_rig.drawing.bench import Chart, Curve
from can_rig.drawing.names import Names
from can_rig.frames.network import Network
from can_rig.logs.columns import EVIDENCE
from can_rig.results.isolation import in_words

EVIDENCE_COLOURS: Final = ("orange", "gold", "violet", "blue", "green", "pink", "grey")

DASHES: Final = ((), (8, 3), (3, 3), (), (8, 3), (3, 3), (10, 3, 2, 3))
"""Of the evidence, so that colour is not the only difference."""


def curves_of(names: Names, network: Network, confirm: float | None) -> list[Curve]:
    """The curves of a run; the evidence too where ``confirm`` says what confirms a loss."""
    unit, status = names.output.unit, network.status
    curves = [
        Curve("output", names.output.name, unit, "blue", 2.0),
        Curve("reference", "reference", unit, "gold", 1.4, (5, 4)),
        Curve("error", "reference - output", unit, "blue"),
        Curve("estimate", "fault estimate", unit, "green"),
    ]
    for number, signal in enumerate(names[1:], 1):
        pale = Curve(f"command_{number}", f"{signal.name} commanded", signal.unit, "pale", 3.0)
        curves += [
            pale,
            Curve(f"applied_{number}", f"{signal.name} applied", signal.unit, "orange"),
        ]
    curves += [
        Curve("mode", "mode", "", "blue", stepped=True, words=in_small_letters(status.modes)),
        Curve(
            "fault_state",
            "fault state",
            "",
            "orange",
            stepped=True,
            words=in_small_letters(status.fault_states),
        ),
    ]
    if confirm is not None:
        looks = zip(EVIDENCE, EVIDENCE_COLOURS, DASHES, strict=True)
        for verdict, (column, colour, dash) in enumerate(looks, 1):
            curves.append(Curve(column, in_words(verdict, names), "", colour, 1.6, dash))
        curves.append(Curve("confirm", "confirms a loss", "", "ink", 1.2, (2, 4)))
    return curves


def charts_of(names: Names, confirm: float | None) -> list[Chart]:
    """The charts of a live run at its beginning."""
    output, *commands = names
    charts = [
        Chart(output.name, ("output", "reference")),
        Chart("error", ("error",)),
        *(
            Chart(signal.name, (f"command_{number}", f"applied_{number}"))
            for number, signal in enumerate(commands, 1)
        ),
    ]
    if confirm is not None:
        charts.append(Chart("evidence of each fault", (*EVIDENCE, "confirm"), "asinh"))
    return charts


def in_small_letters(words: Mapping[int, str]) -> dict[int, str]:
    """The words of a value table, for a person."""
    return {code: word.lower().replace("_", " ") for code, word in words.items()}
