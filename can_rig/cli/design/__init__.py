"""The commands that examine a scenario before a run, and the thesis's figures."""
