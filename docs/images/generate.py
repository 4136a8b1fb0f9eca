"""Take the viewer's documentation pictures again: python docs/images/generate.py.

Records the expert with strong exploration noise in every scene, smooths that, and takes the
pictures headless. Needs software Vulkan (mesa-vulkan-drivers) and about a minute.
"""

import io
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from PIL import Image

from coordlog.record.dataset import open as open_logs
from coordlog.record.reader import read_attachments, read_episode
from coordlog.view.headless import Headless
from coordlog.view.overview import to_overview
from coordlog.view.recording import to_rerun
from coordlog.view.show import Show

FOLDER = Path(__file__).parent
SIZE = (1500, 940)
COLOURS = 256
"""Of the palette: keeps a picture under 150 kB."""
SHARE = 0.62
"""Where in an episode the pictures are taken."""


def main() -> None:
    """Write view-*.png beside this file."""
    with tempfile.TemporaryDirectory() as name, Headless(size=SIZE) as viewer:
        folder = Path(name)
        for scene in ("free", "spheres", "table", "shelf"):
            run(
                "record",
                "--scene",
                scene,
                "--episodes",
                "16",
                "--noise",
                "0.5",
                "--split",
                "test",
                "--out",
                str(folder / "raw"),
            )
        run("smooth", str(folder / "raw"), "--out", str(folder / "smoothed"))
        pairs = {
            path.name.split("-")[0]: (path, folder / "smoothed" / path.name)
            for path in clean(folder)
        }
        for scene, (_, smoothed) in pairs.items():
            take(viewer, folder, [show(smoothed, scene)], f"view-{scene}")
        take(
            viewer,
            folder,
            [
                show(path, name)
                for path, name in zip(pairs["table"], ("raw", "smoothed"), strict=True)
            ],
            "view-raw-and-smoothed",
        )
        take(
            viewer,
            folder,
            [
                show(path, name)
                for path, name in zip(pairs["shelf"], ("raw", "smoothed"), strict=True)
            ],
            "view-ghosts",
            ghosts=True,
        )
        logs = open_logs(folder / "raw")
        shows = [replace(show(path, path.stem), file=f"logs/{path.name}") for path in logs.paths]
        save(viewer, to_overview(shows), folder / "overview.rrd", len(shows) // 2, "view-overview")


def clean(folder: Path) -> list[Path]:
    """Raw files whose episode succeeds cleanly, raw and smoothed; of every scene the last."""
    results = {
        path: read_episode(path) for path in open_logs([folder / "raw", folder / "smoothed"]).paths
    }
    made = {
        path.name
        for path, episode in results.items()
        if path.parent.name == "smoothed" and episode.path is not None and episode.result.clean
    }
    return [
        path
        for path, episode in results.items()
        if path.parent.name == "raw" and episode.result.clean and path.name in made
    ]


def show(path: Path, name: str) -> Show:
    """An episode under a name that tells nothing of this machine."""
    return Show(name, read_episode(path), read_attachments(path), f"{path.parent.name}/{path.name}")


def take(
    viewer: Headless, folder: Path, shows: list[Show], name: str, *, ghosts: bool = False
) -> None:
    """A picture of one or two episodes under way."""
    save(
        viewer,
        to_rerun(shows, ghosts=ghosts),
        folder / f"{name}.rrd",
        SHARE * float(shows[-1].episode.time[-1]),
        name,
    )


def save(viewer: Headless, stream: object, rrd: Path, at: float, name: str) -> None:
    """The picture, with a palette of few colours; nothing in it may have failed to show."""
    stream.save(str(rrd))  # type: ignore[attr-defined]
    stream.disconnect()  # type: ignore[attr-defined]
    viewer.open(rrd)
    viewer.seek(at)
    picture = Image.open(io.BytesIO(viewer.picture())).convert("RGB")
    below = picture.crop((0, 36, *picture.size))  # the window's empty title bar
    below.quantize(COLOURS, dither=Image.Dither.NONE).save(FOLDER / f"{name}.png", optimize=True)
    assert viewer.complaints() == []


def run(*arguments: str) -> None:
    """A command of coordlog; smooth may exit with 3 for episodes it keeps raw."""
    done = subprocess.run([sys.executable, "-m", "coordlog.cli", *arguments], check=False)
    assert done.returncode in (0, 3), arguments


if __name__ == "__main__":
    main()
