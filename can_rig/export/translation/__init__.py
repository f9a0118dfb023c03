"""From the syntax tree of the lines that run on the target to C99 that does the same, bit for bit.

`source` reads a module, `inference` gives every expression a type, `effects` says what a function
changes and refuses what C evaluates in another order, the rest writes C.
"""
