"""The commands that read a log or a run folder."""
