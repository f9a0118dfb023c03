"""The default bus: no root, no kernel module, any number of listeners."""
