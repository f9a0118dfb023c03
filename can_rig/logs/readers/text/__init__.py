"""Text logs: their bytes in blocks, their lines, and a compiled parser for each format.

`blocks` reads and unpacks, `lines` feeds whole lines to a parser, `scanning` holds what the parsers
share; each format is a module with its header and a module with its compiled lines.
"""
