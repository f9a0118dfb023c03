"""Logs of every format as columns of frames."""
