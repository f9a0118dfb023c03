"""A run that is touched while it goes on, from both ends: who obeys, and who asks.

The nodes of a run import it; it imports what both ends of the bus share.
"""
