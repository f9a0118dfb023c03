"""Decoded columns into files: tables (CSV, Parquet) and MDF 4, whole or not at all.

`output.output` is the interface, which `files` of the room above imports.
"""
