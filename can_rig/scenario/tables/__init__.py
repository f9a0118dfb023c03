"""The keys of tables within tables: a plant by numbers, anybody's network, a fault.

``changes`` reads and writes keys with dots, which name values within tables. This room imports the
parts of `firmware_model` that its keys describe; `scenario` combines the tables.
"""
