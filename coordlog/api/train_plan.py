"""What is asked of a training run, and the settings that follow from it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from coordlog.errors import ConfigError
from coordlog.parallel import workers

if TYPE_CHECKING:
    from coordlog.tasks.scene import Scene
    from coordlog.train.settings import Settings

STEPS = 150_000
"""Live steps of a run with the preset `default` that names no budget: enough for `free`."""


UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9}
_SIZE = re.compile(r"(\d+(?:\.\d+)?) ?([kMG]?)B?")


@dataclass(frozen=True)
class TrainPlan:
    """What is to be learnt, from what, and where the run is kept.

    Example:
        >>> TrainPlan(scene="free", steps=600_000, preset="paper").mode
        'live'
    """

    source: Sequence[str | Path] | None = None
    """Logs to learn from."""
    live: bool = False
    """Simulate as well, if there are logs; without logs it always does."""
    scene: str | Scene = ""
    """Scene to simulate, its name, or FILE.py:NAME; by default that of the logs."""
    where: str = ""
    """Which episodes, in SQL."""
    preset: str = ""
    """default, live, agile, quick, or paper; without a word and without logs, live where there are
    fixed obstacles, agile where they stand elsewhere in every episode."""
    config: Path | None = None
    """TOML file of settings, [env] and [reward]."""
    settings: Sequence[str] | None = None
    """Single settings over those, "section.key=value"."""
    updates: int | None = None
    """Gradient updates; 0, as with `steps` alone: as many as those earn."""
    steps: int | None = None
    """Live environment steps; by default the preset's."""
    start: str = "stand"
    """Start pose of the robot."""
    hindsight: float | None = None
    """Share of each batch with goals in hindsight."""
    seed: int = 0
    """Of everything random."""
    envs: int = 32
    """Live simulations at once."""
    eval_every: int | None = None
    """Updates between evaluations; 0 for none."""
    eval_episodes: int = 100
    """Held-out episodes per evaluation."""
    out: Path | None = None
    """Run folder; by default runs/SCENE-SOURCE-sSEED."""
    resume: bool = False
    """Go on with the run in `out`, exactly where it stopped."""
    device: str = "cpu"
    """Where the networks live."""
    skip_broken: bool = False
    """Leave out broken files instead of stopping."""
    verify: bool = False
    """Read every log again, also those that did not change."""
    memory: str = ""
    """Bytes of the window that logs stream through, such as "500MB"; "" holds all of them."""
    collectors: int = 0
    """Collectors that share the live simulations; 0 for none but the learner's own process."""
    jobs: int | str = 0
    """Processes that read logs, 0 for one per core; or a cluster: for the collectors, if any."""
    tensorboard: bool = False
    """Also write TensorBoard event files into the run folder."""
    view: bool = False
    """Watch in rerun."""

    @property
    def window(self) -> int:
        """Bytes of the window that logs stream through; 0 without one."""
        found = _SIZE.fullmatch(self.memory.strip())
        if self.memory and found is None:
            raise ConfigError(f"--memory: expected a size such as 500MB or 2GB, got {self.memory}")
        return int(float(found[1]) * UNITS[found[2]]) if found else 0

    @property
    def readers(self) -> int | str:
        """Where logs are read."""
        jobs = workers(self.jobs)
        return 0 if self.collectors and isinstance(jobs, str) else jobs

    @property
    def mode(self) -> str:
        """What is learnt from: logs, live, or both."""
        return ("both" if self.live else "logs") if self.source else "live"


class Constants(NamedTuple):
    """All constants of a run."""

    preset: str
    settings: Settings
    tables: dict[str, dict[str, Any]]
    """Tables "env", "reward" and "task", as far as they were given."""


def constants(plan: TrainPlan) -> Constants:
    """Preset, then file, then single settings, then the options that have names of their own.

    Raises:
        ConfigError: for an unknown name, a value out of range, or no budget of live steps.
    """
    from coordlog.config import read_toml
    from coordlog.train.settings import load_settings

    tables = read_toml(plan.config) if plan.config else {}
    around, assigned = _around(tables, plan.settings or [])
    given = {
        "loop.seed": plan.seed,
        "loop.updates": plan.updates,
        "loop.steps": plan.steps,
        "loop.evaluate_every": plan.eval_every,
        "replay.hindsight": plan.hindsight,
        "replay.log_hindsight": plan.hindsight,
    }
    # Live steps alone are a budget: without a word about updates, as many as the steps earn.
    if plan.steps and plan.updates is None and "updates" not in tables.get("loop", {}):
        assigned.insert(0, "loop.updates=0")
    preset = plan.preset or preset_of(plan)
    alone = (plan.preset, preset, plan.mode, plan.steps) == ("", "default", "live", None)
    if alone and not tables.get("loop"):
        given |= {"loop.steps": STEPS, "loop.updates": plan.updates or 0}
    own = [f"{key}={value}" for key, value in given.items() if value is not None]
    settings = load_settings(preset=preset, tables=tables, assignments=[*assigned, *own])
    if isinstance(workers(plan.jobs), str) and not plan.collectors and not plan.window:
        raise ConfigError(
            f"--jobs {plan.jobs}: expected --collectors or --memory to share out, got neither; "
            "logs that are held are decoded on this machine"
        )
    if plan.window and not plan.source:
        raise ConfigError("--memory: expected logs to stream, --from, got none")
    if plan.collectors and (plan.mode == "logs" or plan.collectors > plan.envs):
        live = plan.envs if plan.mode != "logs" else "no"
        raise ConfigError(
            "--collectors: expected at most one for each live simulation, "
            f"got {plan.collectors} for {live} simulations"
        )
    if plan.mode != "logs" and settings.loop.steps == 0:
        raise ConfigError("--steps: expected a budget of live steps, got none")
    return Constants(preset, settings, around)


def preset_of(plan: TrainPlan) -> str:
    """The preset of a run that names none: that of the run it goes on with, or what was measured to
    learn best.

    From live steps alone, `live` goes around fixed obstacles, where `default` learns nothing, and
    `agile` around spheres; where nothing is in the way, `default` learns in a third of the steps.
    """
    from coordlog.tasks.own import scene_of
    from coordlog.train.run import recall

    if plan.resume and plan.out is not None:
        return str(recall(plan.out).get("preset", "default"))
    named = plan.scene or "table"
    scene = scene_of(named) if isinstance(named, str) else named
    if plan.mode != "live":
        return "default"
    return "live" if scene.panels else "agile" if scene.spheres else "default"


def _around(
    tables: dict[str, Any], assignments: Sequence[str]
) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """The tables [env], [reward] and [task], taken out of the file's, as assignments change them.

    And the assignments that are not about these.
    """
    from coordlog.config import parse_assignment
    from coordlog.sim.making import TABLES

    around, rest = {name: dict(tables.pop(name)) for name in TABLES if name in tables}, []
    for text in assignments:
        section, key, value = parse_assignment(text)
        if section in TABLES:
            around.setdefault(section, {})[key] = value
        else:
            rest.append(text)
    return around, rest
