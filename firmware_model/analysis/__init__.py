"""The sampled loop as one matrix, its margins, and its simulation without frames.

Imports every other room of `firmware_model`; no other room imports this package.
"""
