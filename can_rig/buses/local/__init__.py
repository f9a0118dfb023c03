"""The default bus, a python-can interface: no root, no kernel module, any number of listeners.

Imported by python-can alone, through the entry point in `pyproject.toml`.
"""
