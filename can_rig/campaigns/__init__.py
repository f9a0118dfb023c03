"""Thousands of runs of one scenario: the variations, the requirements, and a report.

Imported by `cli`; the package imports `results` and lower rooms. Runs have neither bus nor frames:
the loop runs compiled, and the command in a row of the table repeats a run with frames.
"""
