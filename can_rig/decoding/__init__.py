"""Frames into columns of physical values, through any DBC."""
