"""The command line: every command with its options, tables, progress and exit statuses.

`main` names the commands; `runs`, `design` and `logs` have a module for each. What is computed is
computed in other rooms. This room imports all of them, and none of them imports it.
"""
