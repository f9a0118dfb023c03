"""Who computes the runs of a campaign: this process, several, or a cluster."""
