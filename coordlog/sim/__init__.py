"""Robots, scenes and physics: the only room that knows MuJoCo."""
