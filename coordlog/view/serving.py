"""Many episodes as a data set of rerun's own catalogue server: a table to filter, a click to open.

The server keeps what it knows in memory and reads recordings from files, so every episode is drawn
into one first. It listens on 127.0.0.1 alone; its own default is every address.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import rerun as rr

from coordlog.errors import ConfigError, CoordlogError
from coordlog.record.recording import Recording
from coordlog.view.camera import camera
from coordlog.view.layout import layout
from coordlog.view.recording import to_rerun
from coordlog.view.show import Show, stages
from coordlog.view.viewer import HOST, claim

DATASET = "episodes"
BLUEPRINT = "episode.rbl"


class Prepared(NamedTuple):
    """One episode on its way to the server."""

    source: Path
    rrd: str
    """Its drawing; "" if there is none."""
    reason: str
    """Why not; "" if there is one."""


def prepare(numbered: tuple[int, Path], folder: Path) -> Prepared:
    """Draw one episode into a folder; runs in a process of its own.

    What the table shows of it goes along as properties: scene, policy, success, clean, length.
    """
    number, path = numbered
    rrd = folder / f"{number:06}.rrd"
    try:
        recording = Recording(path)
        show = Show(path.stem, recording.episode, recording.attachments, str(path))
        stream = to_rerun([show])
    except CoordlogError as error:
        return Prepared(path, "", str(error).removeprefix(f"{path}: "))
    about, result = recording.header.episode, recording.result
    values: dict[str, Any] = {
        "scene": str(about.get("scene", "")),
        "policy": str(recording.header.policy.get("name", "")),
        "split": str(about.get("split", "")),
        "success": result.success,
        "clean": result.clean,
        "length": result.length,
        "file": str(path),
    }
    stream.send_property("coordlog", rr.AnyValues(**values))
    stream.save(str(rrd))
    stream.disconnect()
    if number == 0:
        staged = stages([show])
        if all(stage.robot.arms for stage in staged):
            layout(staged, camera(staged)).save("coordlog", str(folder / BLUEPRINT))
    return Prepared(path, str(rrd), "")


def prepared(
    paths: Sequence[Path], folder: Path
) -> tuple[Callable[[tuple[int, Path]], Prepared], list[tuple[int, Path]]]:
    """What `parallel.mapped` calls, and with which items, to draw some episodes into a folder."""
    return partial(prepare, folder=folder), list(enumerate(paths))


@contextmanager
def serving(folder: Path, *, port: int = 0) -> Iterator[str]:
    """Serve the drawings in a folder on 127.0.0.1; gives the address to open in the viewer.

    Raises:
        ConfigError: if the catalogue's client is not installed.
        ViewerError: if the port is taken.
    """
    from rerun.server import Server

    try:
        import datafusion  # noqa: F401 - the client asks for it in its own words
    except ModuleNotFoundError:
        raise ConfigError("serve: needs datafusion: pip install 'coordlog[serve]'") from None
    drawings = sorted(folder.glob("*.rrd"))
    with Server(host=HOST, port=claim(port), datasets={DATASET: drawings}) as server:
        if (folder / BLUEPRINT).exists():
            entry = server.client().get_dataset(DATASET)
            entry.register_blueprint((folder / BLUEPRINT).as_uri())
        yield str(server.url())
