"""The syntax tree of the lines that run on the target, read, typed and checked for C.

`source` reads a module, `expressions`, `calls` and `statements` give everything a type, `effects`
says what a function changes and refuses what C would compute in another order.
"""
