"""The name that files written for earlier releases import."""

from coordlog.tasks.scene import SCENES, Panel, Scene, find

__all__ = ["SCENES", "Panel", "Scene", "find"]
