"""Extra frames on every network of the rig: comparing scenarios, commanding a run."""
