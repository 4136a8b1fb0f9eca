"""Robots as data: joints, arms, poses, and where their models come from."""
