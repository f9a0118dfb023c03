"""CAN logs of every common format, read and written as columns of frames.

`reading.read_log` and `writing.write_log` are the interface. `formats` has a module for each
format; the text formats share `text`. The room imports `errors`, `storage`, and `compiled` of
`firmware_model`; every room above may import it.
"""
