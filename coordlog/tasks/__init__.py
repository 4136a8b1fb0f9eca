"""Scenes and tasks: what is observed, rewarded, and what ends an episode."""
