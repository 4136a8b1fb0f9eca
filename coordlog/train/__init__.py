"""Learning from episodes: the only room that knows torch."""

from __future__ import annotations

from coordlog.verbs import make_verb

make_verb(__name__)
