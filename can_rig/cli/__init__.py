"""The command line: every command with its options, tables, progress and exit statuses.

`main` names the commands, which have a module each; the commands print results and compute none.
The command line imports every other room; no room imports `cli`.
"""
