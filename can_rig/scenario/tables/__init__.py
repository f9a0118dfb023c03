"""The keys of tables within a scenario's tables: a plant by numbers, anybody's network.

It imports what its own keys describe in `firmware_model`; `scenario` puts them together.
"""
