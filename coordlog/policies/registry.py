"""A policy by name or by file, for whichever environment it is to act in."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coordlog.errors import ConfigError, FormatError, SpecError, unknown

if TYPE_CHECKING:
    from coordlog.contracts import Policy
    from coordlog.episode import Json
    from coordlog.policies.learned import Origin
    from coordlog.policies.learned import Policy as Trained
    from coordlog.policies.scripted import Constants
    from coordlog.sim.env import BatchEnv

SUFFIX = ".safetensors"
FILES = ("best", "policy")
"""What a run folder may hold, in order of preference."""
DEFAULT_SCENE = "table"
PRETRAINED = "pretrained"
SHIPPED = Path(__file__).parent
"""Policies that come with the package, SCENE.safetensors, and beside each its card, SCENE.json;
SCENE-KIND where several do.
"""
KINDS = ("live",)
"""What is asked for as "pretrained:KIND": "live" has learnt from nothing but its own steps. Where
the policy that ships for a scene is of the kind anyway, it is that one.
"""


def pretrained(scene: str, kind: str = "") -> Path:
    """The policy file that ships for a scene, or the one of a kind.

    Raises:
        ConfigError: if none does.
    """
    found = {}
    for path in sorted(SHIPPED.glob("*.json")):
        file = path.with_suffix(SUFFIX)
        said = card(file)
        if said.get("kind", "") == kind:
            found[said["scene"]] = file
        elif kind == said["training"]["mode"] and not said.get("kind"):
            found.setdefault(said["scene"], file)
    if scene not in found:
        what = f"no {kind} policy" if kind else "no policy"
        raise ConfigError(
            f"{what} ships for scene '{scene}'; one does for: {', '.join(found) or 'none'}; "
            "others come from `coordlog train`"
        )
    return found[scene]


def card(file: Path) -> Json:
    """What the card beside a shipped policy says."""
    said: Json = json.loads(file.with_suffix(".json").read_text(encoding="utf-8"))
    return said


def shipped_kind(name: str) -> str | None:
    """The kind that a name asks for among the policies that ship: "" for "pretrained" alone, None
    for the name of another policy.

    Raises:
        ConfigError: for an unknown kind.
    """
    first, colon, kind = name.partition(":")
    if first != PRETRAINED:
        return None
    if colon and kind not in KINDS:
        raise unknown("policy", name, [PRETRAINED, *(f"{PRETRAINED}:{each}" for each in KINDS)])
    return kind


def policy_file(name: str, scene: str) -> Path | None:
    """The file that a name means: a policy file, one without its suffix, a run folder, or the
    scene's shipped policy.

    None for a scripted policy's name.

    Raises:
        ConfigError: if the name is none of these.
    """
    from coordlog.policies.scripted import SCRIPTED

    if name in SCRIPTED:
        return None
    kind = shipped_kind(name)
    if kind is not None:
        return pretrained(scene, kind)
    path = Path(name)
    candidates = [
        path,
        path.with_name(path.name + SUFFIX),
        *(path / f"{file}{SUFFIX}" for file in FILES),
    ]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    if "/" in name or path.exists():
        raise ConfigError(
            f"{name}: expected a policy file or a run folder with {FILES[0]}{SUFFIX}, found none"
        )
    raise unknown("policy", name, [*SCRIPTED, PRETRAINED, "a run folder or policy file"])


def about(file: Path) -> Json:
    """What a policy file says of itself: scene, env (the `coordlog.env` record it was trained in),
    and how it was trained.

    Raises:
        FormatError: if it is no policy file.
    """
    from coordlog.policies.learned import Policy as Network

    trained = Network.load(file)
    scene, env = _origin(file, trained)
    return trained.about | {"scene": scene, "env": env}


def _origin(file: Path, trained: Trained) -> Origin:
    try:
        return trained.origin()
    except FormatError as error:
        raise FormatError(f"{file}: {error}") from None


def wants_shield(name: str, scene: str) -> bool:
    """Whether a policy is meant to act behind the shield: one that ships says so on its card, no
    other does.
    """
    kind = shipped_kind(name)
    if kind is None:
        return False
    return bool(card(pretrained(scene, kind))["shield"])


def make_policy(
    name: str,
    env: BatchEnv,
    *,
    shield: bool | None = None,
    constants: Constants | None = None,
) -> tuple[Policy, dict[str, Any]]:
    """The policy, and its `coordlog.policy` record without noise.

    Args:
        name: Of a scripted policy, a run folder, a file, "pretrained" or "pretrained:live".
        env: Where it is to act.
        shield: Whether it acts behind a velocity damper (`coordlog.policies.damper`); None: as its
            card says.
        constants: Of a scripted policy, and of the velocity damper.

    Raises:
        ConfigError: for an unknown name or constant, or a shield where there is nothing to be
            shielded from.
        SpecError: if a trained policy does not fit the environment's state or action.
    """
    from coordlog.policies.scripted import Constants, shield_said, with_shield

    given = constants or Constants()
    chosen, said = _unshielded(name, env, given)
    if wants_shield(name, env.scene.name) if shield is None else shield:
        return with_shield(chosen, env, given.damper), said | shield_said(given.damper)
    return chosen, said


def _unshielded(name: str, env: BatchEnv, constants: Constants) -> tuple[Policy, dict[str, Any]]:
    from coordlog.policies.scripted import described, require_none, scripted

    file = policy_file(name, env.scene.name)
    if file is None:
        said = {"kind": "scripted", "name": name, "checkpoint_sha256": ""}
        return scripted(name, env, constants), said | described(name, env, constants)
    require_none(constants, name)
    from coordlog.policies.learned import Policy as Network

    trained = Network.load(file)
    here, (scene, there) = env.describe(), _origin(file, trained)
    for key in ("state", "action_joints"):
        if there[key] != here[key]:
            raise SpecError(
                f"{file}: its {key} is not that of scene '{env.scene.name}'; it was trained in "
                f"scene '{scene}'"
            )
    if (trained.n_x, trained.n_u) != (len(here["state"]), len(here["action_joints"])):
        raise SpecError(
            f"{file}: expected a network of {len(here['state'])} states and"
            f" {len(here['action_joints'])} actions, got {trained.n_x} and {trained.n_u}"
        )
    called = str(file) if shipped_kind(name) is None else f"{PRETRAINED}/{file.stem}"
    return trained, {"kind": "digrad", "name": called, "checkpoint_sha256": _digest(file)}


def _digest(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
