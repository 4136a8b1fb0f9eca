"""Episodes to pictures: the only room that knows rerun."""

from __future__ import annotations

from coordlog.verbs import make_verb

make_verb(__name__)
