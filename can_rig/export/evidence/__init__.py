"""Costs of an exported controller, and findings of analysis tools."""
