"""coordlog: robot episodes that are never lost, never silently wrong, and always replayable."""

__version__ = "0.1.0"
