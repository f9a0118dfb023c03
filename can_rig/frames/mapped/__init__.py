"""Frames of the user's database: found by signal names, in any layout, by cantools.

It imports the rest of `frames`; `scenario` and all rooms above may import `mapped`.
"""
