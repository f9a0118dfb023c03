"""The continuous design: vehicle, plants, factorisation, estimator, compensator, tracking.

It imports nothing of `firmware_model` but `errors`.
"""
