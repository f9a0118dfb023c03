"""The thesis's fault-tolerant controller: continuous designs, discretised into firmware.

Nothing here opens a file, reads a clock or knows a bus: every function is arithmetic on its
arguments, so what is tested here is what runs on the target.
"""
