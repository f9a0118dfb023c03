"""A scenario: TOML to settings, settings to design, target, table and reference.

`shipped/` holds the scenarios of the package. It imports `frames` and `firmware_model`.
"""
