"""Episodes to files and back: the only room that knows MCAP."""
