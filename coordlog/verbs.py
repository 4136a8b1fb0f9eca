"""Packages that are verbs: `coordlog.smooth(...)` works although `coordlog.smooth` is a package.

Importing a submodule binds its name in the parent package, so a function and a package of one name
cannot both live in `coordlog`: whichever was bound last would win. The package itself is made
callable instead, and calls the function of its name in `coordlog.api`.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any


class Verb(ModuleType):
    """A package that can be called; calling it is calling `coordlog.api.NAME`.

    Example:
        >>> import coordlog
        >>> coordlog.record(scene="table", episodes=2, out="logs/")  # doctest: +SKIP
    """

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Do what the function of this name in `coordlog.api` does."""
        api = import_module("coordlog.api")
        return getattr(api, self.__name__.rpartition(".")[2])(*args, **kwargs)


def make_verb(package: str) -> None:
    """Let a package be called; to be used in its `__init__`."""
    sys.modules[package].__class__ = Verb
