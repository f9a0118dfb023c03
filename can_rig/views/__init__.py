"""Runs side by side, signals drawn."""
