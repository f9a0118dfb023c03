"""The words for mode and fault state are those of the status frame's value tables."""

from pathlib import Path

import cantools
import pytest

from firmware_model.law.status import FaultState, Mode

DBC = Path(__file__).parents[3] / "dbc" / "steer_by_wire.dbc"


@pytest.mark.parametrize("words", [Mode, FaultState])
def test_the_numbers_are_those_of_the_dbc(words):
    status = cantools.database.load_file(DBC).get_message_by_name("CONTROLLER_STATUS")
    tables = [
        {str(word): number for number, word in signal.choices.items()}
        for signal in status.signals
        if signal.choices
    ]
    assert {word.name: word.value for word in words} in tables
