"""One reader for each format: a `Log` → its frames in chunks, and a notice if the end is missing.

`text` and `binary` hold the readers. Imported by `can_rig.logs.reading` alone.
"""
