"""What the reach task logs of its own, for every step.

Version 1 of the file format had these in its `Step`, so the table stands in `spec`.
"""

from __future__ import annotations

from coordlog.spec import REACH

FIELDS = REACH
