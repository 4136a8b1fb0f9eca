"""The public face: every name is there, means the same each time, and loads nothing early."""

from __future__ import annotations

import subprocess
import sys

import pytest

import coordlog


@pytest.mark.parametrize("name", coordlog.__all__)
def test_every_public_name_resolves_and_stays_the_same(name: str) -> None:
    first = getattr(coordlog, name)
    assert getattr(coordlog, name) is first
    assert first is not None


def test_a_verb_can_be_called_whatever_was_imported_before() -> None:
    code = (
        "import importlib, coordlog, coordlog.api\n"
        "verbs = ('record', 'check', 'train', 'smooth', 'view', 'export', 'open')\n"
        "assert all(callable(getattr(coordlog, verb)) for verb in verbs)\n"
        "for room in ('record.reader', 'train.settings', 'smooth.spline', 'view.palette'):\n"
        "    importlib.import_module(f'coordlog.{room}')\n"
        "taken = [verb for verb in verbs if not callable(getattr(coordlog, verb))]\n"
        "assert not taken, f'a package has taken the place of {taken}'\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_star_import_binds_every_public_name() -> None:
    names: dict[str, object] = {}
    exec("from coordlog import *", names)
    assert set(coordlog.__all__) <= set(names)


def test_an_unknown_name_is_refused_by_name() -> None:
    with pytest.raises(AttributeError, match="nothing_of_ours"):
        coordlog.nothing_of_ours  # noqa: B018
