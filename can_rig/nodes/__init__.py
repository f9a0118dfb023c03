"""The plant node and the controller node: lockstep, real time, starting and watching them.

This room imports `plant`, `scenario`, `logs`, `buses` and `frames`; `results`, `replay` and `cli`
use the room.
"""
