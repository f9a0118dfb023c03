"""What unstable poles and zeros in the right half plane take: coprime factors, T, limits.

Imports of `design` nothing but `zpk`.
"""
