"""What the parts of coordlog promise one another, on one page.

    Task      goals, what the policy sees, rewards and endings        tasks/<name>/
    Env       simulations that are reset and stepped together         sim/env.py, record/recorder.py
    Policy    state in, action out                                    policies/
    Checker   how close a posture is to touching anything             kinematics/clearance.py
    Learner   updates a policy from batches of transitions            train/digrad.py
    Store     where episode files are kept                            record/store.py

They are protocols: nothing inherits from them, and whatever has these members fits. Letters in
shapes: N simulations, n of them at once, k arms, n_x policy state, n_u action, T steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from coordlog.episode import Array

_OWN = ("columns", "diverged", "contacts")


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one step led to, one row per simulation stepped.

    Every column is an attribute too: `outcome.reward` is `outcome.columns["reward"]`.

    Example:
        >>> outcome = env.step(action, ids)                     # doctest: +SKIP
        >>> over = outcome.terminated | outcome.truncated       # doctest: +SKIP
        >>> outcome.columns["torque"].shape                     # doctest: +SKIP
        (16, 19)
    """

    columns: Mapping[str, Array]
    """Every field that holds after a step, by name, (n, …): the core's `reward` (n, k),
    `terminated` and `truncated` (n,), `ctrl` and `torque` (n, n_c), then the task's own."""
    diverged: Array
    """Whether the state is no number any more, (n,) bool; then no column means anything."""
    contacts: list[Array]
    """CONTACT rows per simulation, their step not yet filled in."""

    def __getattr__(self, name: str) -> Array:
        """A column by its name.

        Raises:
            AttributeError: if no column is called that; the message lists those that are.
        """
        if name not in _OWN and not name.startswith("__") and name in self.columns:
            return self.columns[name]
        has = ", ".join(self.columns) if name not in _OWN and "columns" in vars(self) else "none"
        raise AttributeError(f"outcome: expected one of its columns ({has}), got '{name}'")
