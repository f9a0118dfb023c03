"""The continuous design: vehicle, plants, factorisation, estimator, compensator, tracking.

Imports only `errors` of `firmware_model`.
"""
