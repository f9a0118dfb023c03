"""The command line: options, tables, progress and exit statuses, no computation.

Imports every other room; nothing imports it.
"""
