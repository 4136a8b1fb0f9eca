"""The colours of all panels: one hue per arm in the scene and in the plots, one per joint within a
group.
"""

from __future__ import annotations

from collections.abc import Sequence

Colour = tuple[int, int, int, int]

ARMS: tuple[Colour, ...] = (
    (72, 149, 239, 255),
    (255, 140, 66, 255),
    (88, 196, 122, 255),
    (196, 118, 232, 255),
)
"""By the arm's place in the robot's spec, as the humanoid's own sides."""
JOINTS: tuple[Colour, ...] = (
    (78, 161, 255, 255),
    (255, 158, 74, 255),
    (103, 208, 125, 255),
    (240, 106, 118, 255),
    (182, 140, 240, 255),
    (226, 200, 84, 255),
    (94, 210, 210, 255),
    (240, 140, 200, 255),
)
EXECUTED: Colour = (150, 158, 170, 255)
GOOD: Colour = (64, 196, 99, 255)
FAIR: Colour = (240, 190, 60, 255)
BAD: Colour = (240, 72, 72, 255)
MASS: Colour = (250, 225, 90, 255)
FLOOR: tuple[Colour, Colour] = ((92, 99, 110, 255), (76, 82, 92, 255))
BACKGROUND: Colour = (28, 32, 38, 255)


def cycle(colours: Sequence[Colour], index: int) -> Colour:
    """A colour by number, from the start again after the last."""
    return colours[index % len(colours)]


def pale(colour: Colour, share: float = 0.5) -> Colour:
    """The colour mixed with the background, for what stands behind."""
    red, green, blue = (
        round(c + (b - c) * share) for c, b in zip(colour[:3], BACKGROUND, strict=False)
    )
    return red, green, blue, colour[3]


def bright(colour: Colour, share: float = 0.65) -> Colour:
    """The colour mixed with white, for what lies on top."""
    red, green, blue = (round(c + (255 - c) * share) for c in colour[:3])
    return red, green, blue, colour[3]


def rgba(colour: Sequence[float], *, alpha: float = 1.0) -> Colour:
    """MuJoCo's rgba in [0, 1], made more transparent by a factor."""
    red, green, blue, opacity = (
        round(255 * max(0.0, min(1.0, value))) for value in (*colour[:3], colour[3] * alpha)
    )
    return red, green, blue, opacity
