"""Frames of anybody's database: found by the names of their signals, in any layout, by cantools.

It imports the rest of `frames`; `scenario` and every room above it may import it.
"""
