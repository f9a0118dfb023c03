"""Figures of the sampled firmware over the continuous loop, of the thesis and of any plant."""

from can_rig.errors import require

require("control", extra="figures")
