"""Tests for modest.py: a few bytes of a model do not ask for a million geoms."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from coordlog.errors import FormatError
from coordlog.mjcf import compose
from coordlog.modest import MOST_ATTRIBUTES, MOST_DEPTH, MOST_ELEMENTS, is_plain, require_modest
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import SCENES

GEOM = '<geom size="1"/>'
MANY = " ".join(f"a{i}='1'" for i in range(MOST_ATTRIBUTES + 1))


def root(inside: str) -> ET.Element:
    return ET.fromstring(f"<mujoco>{inside}</mujoco>")


@pytest.mark.parametrize("name", sorted(SCENES))
def test_our_own_models_are_modest_and_plain(name: str) -> None:
    model = ET.fromstring(compose(SCENES[name], EnvConfig()).text)
    require_modest(model)
    assert is_plain(model)


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        (f'<worldbody><replicate count="2000000">{GEOM}</replicate></worldbody>', "elements"),
        (f'<replicate count="200"><replicate count="200">{GEOM}</replicate></replicate>', "elem"),
        (f'<replicate count="1e9">{GEOM}</replicate>', "elements"),
        ('<composite count="100 100 100"/><composite count="100 100 100"><x/></composite>', "elem"),
        (GEOM * (MOST_ELEMENTS + 1), "elements"),
        ("<frame>" * MOST_DEPTH + "</frame>" * MOST_DEPTH, "within one another"),
        ('<option timestep="4e-9"/>', "timestep"),
        ('<option timestep="nan"/>', "timestep"),
        ('<option iterations="2000000000"/>', "iterations"),
        ('<asset><hfield nrow="100000" ncol="100000"/></asset>', "cells"),
        ('<asset><texture width="1000000" height="1000000"/></asset>', "cells"),
        ('<size memory="900G"/>', "memory"),
        ('<size nuserdata="1000000000"/>', "nuserdata"),
        ('<size nkey="999999"/>', "nkey"),
        (f"<geom {MANY}/>", "attributes"),
        ('<custom><numeric name="a" size="1000000000"/></custom>', "size"),
    ],
)
def test_a_model_that_asks_for_too_much_is_refused(inside: str, said: str) -> None:
    with pytest.raises(FormatError, match=said):
        require_modest(root(inside))


@pytest.mark.parametrize(
    "inside",
    [
        f'<replicate count="100">{GEOM}</replicate>',
        '<option timestep="0.0005" iterations="100"/><size memory="64M" njmax="5000"/>',
        '<asset><hfield nrow="500" ncol="500"/><texture width="512" height="512"/></asset>',
    ],
)
def test_a_usual_model_is_not(inside: str) -> None:
    require_modest(root(inside))


def test_what_takes_a_trial_is_not_plain() -> None:
    assert is_plain(root(GEOM * 200))
    assert not is_plain(root(GEOM * 300))
    assert not is_plain(root('<asset><mesh name="a"/></asset>'))
    assert not is_plain(root('<size nuserdata="900000"/>'))
