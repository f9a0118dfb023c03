"""The effects of a scenario's scheduled faults: in the plant, and on frames in transit.

Each effect is a small object or function; overlapping faults act in the scenario's order.
``delivery`` computes the fate of frames without sending any frame. May import ``scenario`` and
``frames``.
"""
