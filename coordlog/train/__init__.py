"""Learning from episodes: the only room that knows torch."""
