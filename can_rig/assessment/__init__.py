"""Before a run: is the loop stable, what does it bear, which tuning suits it, and which bus.

Imported by `cli`, `thesis` and `results` at most; it imports `scenario` and what lies below.
"""
