"""Each text format has a module for the header, and a compiled module for the lines.

Imported by `can_rig.logs.reading` alone.
"""
