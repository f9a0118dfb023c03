"""A writer for each format: the frames of a `Log` → a file.

Imported by `can_rig.logs.writing` alone.
"""
