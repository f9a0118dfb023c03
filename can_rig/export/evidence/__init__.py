"""What an exported controller costs, and what tools find in it."""
