"""The two nodes by the wall clock."""
