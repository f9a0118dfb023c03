"""What the scheduled faults of a scenario do: in the plant, and to frames on their way.

Each is a small object or function of its own; faults that overlap act one after the other, in the
order of the scenario. ``delivery`` says what becomes of the frames without sending one. May import
``scenario`` and ``frames``.
"""
