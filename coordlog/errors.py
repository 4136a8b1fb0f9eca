"""Every error coordlog raises on purpose, as one tree.

CoordlogError                exit code 2
├── ConfigError              unknown name, unknown key, value out of range
├── SpecError                an array is not what its declaration says
├── FormatError              not a coordlog episode: foreign, empty, another schema version
│   └── TruncatedError       an episode that ends before its commit marker; `coordlog recover` helps
├── StorageError             the file system said no: full, read-only, would overwrite
├── SimulationError          the physics cannot be built or has diverged
├── ViewerError              the viewer cannot start: no display, no Vulkan, a port that is taken
└── WorkerError              a process that worked for this one was killed

A message is one sentence or two: what, wanted, got, what to do. The command line prints it and
exits with `exit_code`; a library user catches `CoordlogError`.
"""

from __future__ import annotations

EXIT_OK = 0
EXIT_CHECK_FAILED = 1
EXIT_BAD_INPUT = 2
EXIT_PARTIAL = 3
EXIT_INTERRUPTED = 130


class CoordlogError(Exception):
    """Base of all errors raised on purpose; `exit_code` is what the command line returns."""

    exit_code = EXIT_BAD_INPUT


class ConfigError(CoordlogError):
    """An unknown name or key, or a value out of its range."""


class SpecError(CoordlogError):
    """An array whose shape, type or values are not what its declaration says."""


class FormatError(CoordlogError):
    """A file that is not a coordlog episode of a schema version this release reads."""


class TruncatedError(FormatError):
    """An episode file that ends before its commit marker."""


class StorageError(CoordlogError):
    """The file system refused: full, read-only, or the write would replace a file."""


class SimulationError(CoordlogError):
    """A model that does not compile, or physics that diverged."""


class ViewerError(CoordlogError):
    """The viewer cannot start or does not answer; the message says what works instead."""


class WorkerError(CoordlogError):
    """A process that worked for this one was killed, from outside or for want of memory."""


EXTRA_OF = {
    "gymnasium": "gym",
    "torch": "train",
    "safetensors": "train",
    "duckdb": "catalog",
    "rerun": "view",
    "rerun_cli": "view",
    "matplotlib": "view",
    "PIL": "view",
    "tensorboard": "tensorboard",
    "rosbags": "exchange",
    "h5py": "exchange",
    "av": "exchange",
    "obstore": "cloud",
    "ray": "cluster",
}
"""The extra of the package that brings an optional library, by the library's import name."""


def missing_extra(error: ModuleNotFoundError) -> ConfigError | None:
    """Error for an optional library that is not installed; None if it is none of ours.

    Example:
        >>> missing_extra(ModuleNotFoundError("no torch", name="torch"))
        ConfigError("this needs torch, which is not installed: pip install 'coordlog[train]'")
    """
    library = (error.name or "").partition(".")[0]
    if library not in EXTRA_OF:
        return None
    return ConfigError(
        f"this needs {library}, which is not installed: pip install 'coordlog[{EXTRA_OF[library]}]'"
    )


def unknown(kind: str, got: str, choices: object) -> ConfigError:
    """Error for a name that is not among its choices; the message lists them."""
    names = ", ".join(sorted(str(choice) for choice in choices))  # type: ignore[attr-defined]
    return ConfigError(f"unknown {kind} '{got}'; choose one of: {names}")
