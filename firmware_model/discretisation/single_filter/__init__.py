"""A single discretised filter from any continuous filter: runs, rounding bounds, C source."""
