"""Commands during a run, from both ends: the obeying plant node and the operator.

The nodes of a run import `operator`; `operator` imports modules common to both ends of the bus.
"""
