"""Computing a campaign's runs: this process, several, or a cluster."""
