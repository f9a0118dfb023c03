"""What five frames cost on a real bus, before there is one."""
