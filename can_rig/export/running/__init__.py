"""Exported code, compiled and run: the law in this process, the node here or on a board."""
