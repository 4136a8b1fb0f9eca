"""Models: a robot's own files taken in, a scene composed around it, and what a log carries loaded.

Nothing here edits text: a model is read into MuJoCo's `MjSpec`, edited there and printed once, and
what is simulated is compiled from that print, which is what the log holds.
"""

from coordlog.mjcf.attached import (
    ASSETS,
    MAX_BYTES,
    is_plain_model,
    load_attached,
    load_model,
    pack_source,
    self_contained,
    silence,
)
from coordlog.mjcf.compose import compose, with_radii
from coordlog.mjcf.dressed import load_dressed, worn_by
from coordlog.mjcf.looks import Looks, looks_of, robot_looks
from coordlog.mjcf.others import same_physics, text_of
from coordlog.mjcf.printing import Source, compile_model
from coordlog.mjcf.servos import actuator_label, held_controls, servos_of
from coordlog.mjcf.source import model_alone

__all__ = [
    "ASSETS",
    "MAX_BYTES",
    "Looks",
    "Source",
    "actuator_label",
    "compile_model",
    "compose",
    "held_controls",
    "is_plain_model",
    "load_attached",
    "load_dressed",
    "load_model",
    "looks_of",
    "model_alone",
    "pack_source",
    "robot_looks",
    "same_physics",
    "self_contained",
    "servos_of",
    "silence",
    "text_of",
    "with_radii",
    "worn_by",
]
