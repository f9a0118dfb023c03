"""One reader for each format: a `Log` → its frames, chunk by chunk, and what its end lacks.

`text` and `binary` hold them. Imported by `can_rig.logs.reading` alone.
"""
