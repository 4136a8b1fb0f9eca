"""The name that files written for earlier releases import."""

from coordlog.robots.robot import Arm, Robot

__all__ = ["Arm", "Robot"]
