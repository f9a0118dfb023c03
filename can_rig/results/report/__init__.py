"""`report.png`: its title, its panels, and the timing of a run in real time."""
