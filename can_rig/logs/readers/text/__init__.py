"""Text logs: their bytes in blocks, their lines, and what the compiled parsers share.

`blocks` reads and unpacks, `lines` feeds whole lines to a parser, `headed` adds a start to their
times, `scanning` reads words and numbers; the formats themselves are in `formats`.
"""
