"""The commands that look at a scenario before it is run, and the thesis's figures."""
