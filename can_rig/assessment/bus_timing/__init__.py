"""When frames arrive on a bus at worst: frame lengths, response times, the latency in ticks.

Imported by `assessment` and `cli`; it imports `frames` and `errors`.
"""
