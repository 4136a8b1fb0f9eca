"""What coordlog's policies achieve, measured on problems that no training saw, and the page that
says so (docs/results.md).

Not part of the installed package: run from a checkout, `python -m experiments.ship`, `python -m
experiments.report`; `make results` is both.
"""

import os

os.environ.setdefault(
    "OMP_NUM_THREADS", "1"
)  # times are of one core; read when NumPy is loaded, so it stands here
