"""Common parts of all pictures: palette, line styles, page, shading of a loss, names and units.

Imported by the rooms that draw or print (`results`, `views`, `assessment`, `thesis`, `cli`); the
package imports `scenario`, `frames` and lower rooms. Only `style` loads matplotlib.
"""
