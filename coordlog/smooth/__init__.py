"""Joint trajectories made smooth, and proven no less safe than they were."""
