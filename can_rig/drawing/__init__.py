"""What every picture shares: palette, line styles, page, shading of a loss, names and units.

Imported by the rooms that draw or print (`results`, `views`, `assessment`, `thesis`, `cli`); it
imports `scenario`, `frames` and what lies below. Only `style` loads matplotlib.
"""
