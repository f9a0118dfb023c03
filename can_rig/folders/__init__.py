"""Folders of results: what may replace what, and a folder that grows until it is whole.

Imported by everything that writes a folder; it imports `files` and `errors` alone.
"""
