"""A module for the header of each text format, and one for its lines, which is compiled.

Imported by `can_rig.logs.reading` alone.
"""
