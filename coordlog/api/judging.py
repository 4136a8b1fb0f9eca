"""Evaluations of a policy on held-out problems, recorded like any other episodes."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coordlog.policies.learned import Policy
from coordlog.record.beside import keep
from coordlog.record.dataset import SUFFIX
from coordlog.record.reader import read_attachments, read_episode
from coordlog.record.recorder import Recorder
from coordlog.sim.making import make_env
from coordlog.sim.scoring import Scoreboard, figures, judged

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.sim.env import BatchEnv
    from coordlog.tasks.scene import Scene
    from coordlog.view.live import Live

SEED = 0
"""Evaluations are on the problems of this seed and the split "test", which no training sees."""
ENVS = 32
"""Simulations at once, at most."""
RANK = ("clean", "overall", "score")
"""The best policy is the cleanest from the start pose asked for.

Among equals the one cleanest from all.
"""
ELSEWHERE = 5
"""From logs alone, which begin in one pose, the others are judged on one problem in so many."""
STARTS = ("stand", "home")
"""Poses that evaluations begin in, as far as the robot has them."""


def evaluation_envs(
    scene: Scene | str, tables: Mapping[str, Any], like: Json | None, *, start: str, envs: int
) -> dict[str, BatchEnv]:
    """The true scene from every start pose that is judged, by the prefix of its figures: none for
    `start`, "home_" for home.

    Args:
        scene: What to judge in, or the name of a scene that ships.
        tables: Tables "env" and "reward" of constants.
        like: A `coordlog.env` record whose constants hold where the tables say nothing.
        start: The first pose; the robot's others in STARTS follow.
        envs: Simulations at once.
    """
    make = partial(make_env, scene, tables, envs=envs, threads=0, like=like)
    first = make(start=start)
    others = [pose for pose in STARTS if pose != start and pose in first.scene.robot.poses]
    return {"": first, **{f"{pose}_": make(start=pose) for pose in others}}


class Judge:
    """Evaluates a policy on held-out problems of the true scene, from several start poses.

    The episodes are recorded like any other.
    """

    def __init__(
        self,
        envs: Mapping[str, BatchEnv],
        folder: Path,
        *,
        run: str,
        episodes: int,
        elsewhere: int,
        window: Live | None = None,
    ) -> None:
        """Write nothing yet.

        Args:
            envs: What to judge in, as `evaluation_envs` makes them.
            folder: The run folder.
            run: Name of the run, for its recordings.
            episodes: Problems from the first start pose.
            elsewhere: Problems from each of the others.
            window: Where evaluations are shown, if anywhere.
        """
        self._envs, self._run, self._window, self._folder = envs, run, window, folder
        self._episodes = dict.fromkeys(envs, elsewhere) | {"": episodes}

    def __call__(self, policy: Policy, updates: int) -> dict[str, float | str]:
        """Figures of merit after so many updates: those of `scoring.figures` per start pose, and
        "overall", the mean of their clean rates.

        What a killed run had recorded of them is not recorded twice.
        """
        folder = self._folder / "episodes" / f"eval-{updates:07d}"
        boards = {
            prefix: self._judge(
                prefix, policy, updates, folder.with_name(folder.name + suffix(prefix))
            )
            for prefix in self._envs
        }
        found: dict[str, float | str] = {}
        for prefix, board in boards.items():
            found |= {prefix + name: value for name, value in figures(board.scores).items()}
        found["overall"] = sum(float(found[f"{prefix}clean"]) for prefix in boards) / len(boards)
        touches = boards[""].touches.most_common(1)
        model = self._envs[""].task.model
        found["touched"] = (
            " and ".join(model.geom(geom).name for geom in touches[0][0]) if touches else ""
        )
        if self._window is not None:
            show(self._window, updates, folder)
        return found

    def _judge(self, prefix: str, policy: Policy, updates: int, folder: Path) -> Scoreboard:
        """One evaluation from one start pose, recorded."""
        env = self._envs[prefix]
        said = {"kind": "digrad", "name": f"update {updates}", "checkpoint_sha256": "", "noise": {}}
        run = run_of(self._run, updates, policy)
        keep(self._folder, env.looks.meshes)
        with Recorder(env, folder, policy=said, display=False, run=run) as recorder:
            return judged(
                recorder, policy, episodes=self._episodes[prefix], k=env.layout.k, seed=SEED
            )


def run_of(run: str, updates: int, policy: Policy) -> str:
    """The name that an evaluation's recordings carry: the same where a run that goes on comes to
    the same weights again.
    """
    weights = b"".join(policy.arrays[name].tobytes() for name in sorted(policy.arrays))
    return hashlib.sha256(f"{run}/{updates}/".encode() + weights).hexdigest()[:8]


def show(window: Live, updates: int, folder: Path) -> None:
    """Show the recorded episodes of an evaluation."""
    from coordlog.view.show import Show

    paths = sorted(folder.glob(f"*{SUFFIX}"))
    window.evaluation(
        updates,
        [Show(path.stem, read_episode(path), read_attachments(path), str(path)) for path in paths],
    )


def suffix(prefix: str) -> str:
    """What the folder of an evaluation from another start pose is called after: "home_" →
    "-home".
    """
    return f"-{prefix.rstrip('_')}" if prefix else ""
