"""The one place that says which release this is; written into every file."""

__version__ = "0.1.0"
