"""``report.png``: its page, its title, and the panel that only a real-time run has.

Imported by `results` alone, when a run is over: it loads matplotlib.
"""
