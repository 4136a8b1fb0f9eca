"""The name that files written for earlier releases import."""

from coordlog.tasks.config import EnvConfig, RewardConfig

__all__ = ["EnvConfig", "RewardConfig"]
