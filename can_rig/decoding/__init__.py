"""Frames into columns of physical values, through any CAN database; and the columns into files.

`decode.decode_log` is the interface. The room imports `logs`, `frames`, `storage` and `errors`;
rooms above may import `decoding`.
"""
