"""The thesis's figures, and its continuous loop by another way."""
