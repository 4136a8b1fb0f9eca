"""Joint motion as it was found in somebody else's file, and its clock judged and cut.

Stamps are integer nanoseconds from the source to the episode. Nothing is resampled unless asked.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from coordlog.episode import Array, Json
from coordlog.errors import ConfigError, FormatError

NS = 1_000_000_000
GAP = 3.0
"""Median periods that pass without a sample before it is called a gap."""
MOST_SAMPLES = 1000
"""Samples that resampling may make of one: more is a wrong rate, not a wish."""


@dataclass(frozen=True)
class Motion:
    """Samples of some joints of one robot, one after the other.

    Example:
        `Motion(path, "rosbag2", "/joint_states", names, stamps, position).timing.period`
    """

    source: Path
    format: str
    place: str
    """where in the source: a topic, an episode"""
    names: tuple[str, ...]
    """of the joints, as the source calls them"""
    stamps: Array
    """(N,) int64 ns"""
    position: Array
    """(N, n) float64, rad or m"""
    velocity: Array | None = None
    """(N, n) float64"""
    action: Array | None = None
    """(N, n) float64: joint positions that were commanded after each sample"""
    task: str = ""
    clock: str = ""
    """which clock the stamps are of"""
    where: Json = field(default_factory=dict)
    """what finds these samples in the source again"""
    notes: tuple[str, ...] = ()
    """what a person should know about how it was read"""

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.stamps)

    def __str__(self) -> str:
        """File and place, for a message."""
        return f"{self.source}: {self.place}"

    @cached_property
    def timing(self) -> Timing:
        """What the clock did."""
        return timing(self.stamps)

    def rows(self, chosen: Array | slice) -> Motion:
        """Some of the samples; `chosen` are indices, a mask or a slice."""
        return replace(
            self,
            stamps=self.stamps[chosen],
            position=self.position[chosen],
            velocity=None if self.velocity is None else self.velocity[chosen],
            action=None if self.action is None else self.action[chosen],
        )


class Timing(NamedTuple):
    """What a clock did over N samples."""

    samples: int
    period: float
    """median time between two samples [s]"""
    jitter: float
    """standard deviation of the times between samples that are no gaps [s]"""
    gaps: tuple[tuple[int, float], ...]
    """sample after which nothing came for longer than `GAP` periods, and for how long [s]"""
    duplicates: tuple[int, ...]
    """samples with the stamp of the one before"""
    backwards: tuple[int, ...]
    """samples with an earlier stamp than the one before"""

    def __str__(self) -> str:
        """One line for a person."""
        if not self.period:
            return f"{self.samples} samples"
        said = (
            f"{self.samples} samples, {1 / self.period:.4g} Hz, jitter {self.jitter * 1e3:.2g} ms"
        )
        if self.gaps:
            longest = max(seconds for _, seconds in self.gaps)
            said += f", {len(self.gaps)} gaps (longest {longest:.3g} s)"
        if self.duplicates:
            said += f", {len(self.duplicates)} repeated stamps"
        if self.backwards:
            said += f", {len(self.backwards)} steps back in time"
        return said

    def to_json(self) -> Json:
        """Counts and figures for a lineage."""
        return {
            "samples": self.samples,
            "period": self.period,
            "jitter": self.jitter,
            "gaps": [list(gap) for gap in self.gaps],
            "duplicates": len(self.duplicates),
            "backwards": len(self.backwards),
        }


def timing(stamps: Array) -> Timing:
    """Judge a clock by the times between its stamps [ns]."""
    steps = np.diff(stamps)
    forward = steps[steps > 0]
    period = float(np.median(forward)) if len(forward) else np.inf
    regular = forward[forward <= GAP * period]
    gaps = tuple((int(i), float(steps[i]) / NS) for i in np.flatnonzero(steps > GAP * period))
    return Timing(
        len(stamps),
        period / NS if len(forward) else 0.0,
        float(regular.std()) / NS if len(forward) else 0.0,
        gaps,
        tuple((np.flatnonzero(steps == 0) + 1).tolist()),
        tuple((np.flatnonzero(steps < 0) + 1).tolist()),
    )


def require_usable(motion: Motion) -> None:
    """Hold a motion to finite positions and a clock that does not run backwards.

    Raises:
        FormatError: naming the first sample that is wrong.
    """
    if not len(motion):
        raise FormatError(f"{motion}: expected joint positions, got not a single sample")
    if not np.isfinite(motion.position).all():
        bad = np.argwhere(~np.isfinite(motion.position))
        row, joint = bad[0].tolist()
        raise FormatError(
            f"{motion}: sample {row}: joint {motion.names[joint]}: expected a number, got "
            f"{motion.position[row, joint]}; {len({int(i) for i in bad[:, 0]})} of {len(motion)} "
            "samples are unusable: mend the source first"
        )
    back = motion.timing.backwards
    if back:
        at = back[0]
        bag = motion.format == "rosbag2" and motion.clock != "time_from_start"
        other = "--stamps chooses another clock, " if bag else ""
        lost = (motion.stamps[at - 1] - motion.stamps[at]) / NS
        raise FormatError(
            f"{motion}: sample {at}: expected time to go on, got a step back of {lost:.6g} s "
            f"({motion.clock or 'its clock'}); {other}--split-clock begins an episode there"
        )


def prepared(
    motion: Motion, *, gap: float | None, starts: Array | None, split_clock: bool, rate: float
) -> Iterator[Motion]:
    """The episodes in a motion, each with a clock that only goes forward.

    Args:
        motion: As found.
        gap: Begin anew where nothing came for longer than this [s]; None keeps gaps.
        starts: Begin anew at these stamps [ns] too.
        split_clock: Begin anew where time steps back, instead of refusing it.
        rate: Resample to this many samples a second, by straight lines between samples; 0 keeps
            the samples.

    Raises:
        FormatError: if it cannot be used, naming the sample.
    """
    steps = np.diff(motion.stamps)
    cuts = np.zeros(len(motion), bool)
    if split_clock:
        cuts[1:] |= steps < 0
    else:
        require_usable(motion)
    if gap is not None:
        cuts[1:] |= steps > gap * NS
    if starts is not None:
        cuts[np.searchsorted(motion.stamps, starts[starts <= motion.stamps[-1]])] = True
    edges = [0, *(i for i in np.flatnonzero(cuts).tolist() if i), len(motion)]
    for first, stop in itertools.pairwise(edges):
        piece = motion if stop - first == len(motion) else motion.rows(slice(first, stop))
        if split_clock:
            require_usable(piece)
        repeated = piece.timing.duplicates
        if repeated:
            fresh = np.ones(len(piece), bool)
            fresh[list(repeated)] = False
            said = f"{len(repeated)} samples repeat the stamp before and were left out"
            piece = replace(piece.rows(fresh), notes=(*piece.notes, said))
        yield resampled(piece, rate) if rate else piece


def resampled(motion: Motion, rate: float) -> Motion:
    """The motion at even times, by straight lines between its samples; said in its notes.

    Raises:
        ConfigError: if there would be far more samples than there are.
    """
    period = NS / rate
    if (motion.stamps[-1] - motion.stamps[0]) / period > MOST_SAMPLES * len(motion):
        raise ConfigError(
            f"--resample {rate:g}: more than {MOST_SAMPLES} samples for each of the {len(motion)} "
            f"in {motion}; choose fewer a second"
        )
    count = int((motion.stamps[-1] - motion.stamps[0]) / period + 1e-9) + 1
    stamps = motion.stamps[0] + np.rint(np.arange(count) * period).astype(np.int64)
    here, there = (motion.stamps - motion.stamps[0]) / NS, (stamps - stamps[0]) / NS

    def lines(values: Array | None) -> Array | None:
        if values is None:
            return None
        return np.stack([np.interp(there, here, column) for column in values.T], axis=1)

    position = lines(motion.position)
    assert position is not None
    said = f"resampled from {len(motion)} to {count} samples at {rate:g} Hz, by straight lines"
    return replace(
        motion,
        stamps=stamps,
        position=position,
        velocity=lines(motion.velocity),
        action=lines(motion.action),
        notes=(*motion.notes, said),
    )
