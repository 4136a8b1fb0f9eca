"""Other programs' files, in and out: one module per foreign format.

    source       an episode file as an exporter reads it, and where it came from as plain values
    columns      every column of an episode with its labels, whatever fields its task has
    blocks       an export: fixed blocks of episodes, resumable, assembled and renamed at the end
    statistics   the ten statistics of a LeRobot feature
    lerobot      LeRobot v3.0 and v2.1, out          lerobot_source   and in
    minari robomimic rosbag2 tables                  out

`FORMATS` names what `coordlog export --to` can write.
"""

from __future__ import annotations

FORMATS = {
    "lerobot": "coordlog.exchange.lerobot",
    "lerobot2.1": "coordlog.exchange.lerobot21",
    "minari": "coordlog.exchange.minari",
    "robomimic": "coordlog.exchange.robomimic",
    "rosbag2": "coordlog.exchange.rosbag2",
    "parquet": "coordlog.exchange.parquet",
    "csv": "coordlog.exchange.csv",
}
"""Module of each format that can be written; it has `write_block` and `assemble`."""
WITH_IMAGES = ("lerobot", "lerobot2.1", "robomimic")
"""Formats that can hold what a camera sees."""
WITH_ARRAYS = ("robomimic",)
"""Formats that hold images as arrays, and so depth and segmentation too."""
