"""The keys of tables within tables: a plant by numbers, anybody's network, a fault.

``changes`` knows keys with dots, which name what is within a table. It imports what its own keys
describe in `firmware_model`; `scenario` puts them together.
"""
