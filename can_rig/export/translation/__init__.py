"""The syntax tree of the lines that run on the target, read, typed and checked for C.

`source` reads a module, `expressions`, `calls` and `statements` give everything a type,
`assignment` refuses names that need not have a value, `effects` says what a function changes and
refuses what C would compute in another order.
"""
