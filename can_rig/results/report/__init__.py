"""``report.png`` and ``report.html``: pages, title, events, a panel that only a real-time run has.

Imported by `results` alone, when a run is over: it loads matplotlib.
"""
