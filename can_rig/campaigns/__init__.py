"""Thousands of runs of one scenario: what differs between them, what is required of each, a report.

Imported by `cli`; it imports `results` and what lies below. No bus and no frame: the loop runs
compiled, and every run can be repeated with frames by the command that stands in its row.
"""
