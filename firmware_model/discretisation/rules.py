"""The names of the rules of ``tustin``, for settings that need no arithmetic."""

from __future__ import annotations

from typing import Literal, get_args

Rule = Literal["tustin", "tustin-held", "zoh"]
RULE_NAMES: tuple[Rule, ...] = get_args(Rule)
