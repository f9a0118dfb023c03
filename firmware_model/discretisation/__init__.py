"""Continuous filters to δ sections, and sections to the constant table of the target.

It imports `design` and `target`.
"""
