"""The thesis's figures, and its continuous loop by another way."""

from can_rig.errors import require

require("control", extra="figures")
