"""Episodes to files and back: the only room that knows MCAP.

schema cdr chunk records container    the format, from fields to bytes
metadata messages topics tally        what an episode becomes in it
writer storage recorder               writing
opening reader dataset arrow info     reading
finding check structure content       judging; damage and bitflip name what is broken,
replaying                             and replaying simulates it again
recover                               rescuing
"""

from __future__ import annotations

from coordlog.verbs import make_verb

make_verb(__name__)
