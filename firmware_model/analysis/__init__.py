"""The sampled loop as one matrix, its margins, and its simulation without frames.

It imports every other room of `firmware_model`; none of them imports it.
"""
