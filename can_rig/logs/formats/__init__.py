"""A module for each log format: its reader, its writer, and its row for the table of formats.

The table is `FORMATS` in `can_rig.logs.reading`, the only module that imports them.
"""
