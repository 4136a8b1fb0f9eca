"""The paper's figures, ours: scenes (Figure 3), learning curves (Figure 4), joint and hand paths
(Figure 5), into docs/images.

    python -m experiments.figures [scenes curves paths]

Scenes and paths are made anew from the shipped policies; curves are drawn from what is kept in
experiments/curves.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from experiments import curves, tables

IMAGES = Path(__file__).parents[1] / "docs" / "images"
WIDTH = 1600
COLOURS = 200
"""Of the palette: keeps a picture under 200 kB."""
NOISE = 0.15
"""Exploration noise of the episode whose paths are drawn: knots that lie apart from the spline are
what there is to see."""


def scenes() -> Path:
    """All four scenes side by side."""
    with tempfile.TemporaryDirectory() as name:
        coordlog_command("scenes", "--picture", f"{name}/scenes")
        pictures = [
            Image.open(f"{name}/scenes/{scene}.png").convert("RGB") for scene in tables.SCENES
        ]
        width, height = pictures[0].size
        whole = Image.new("RGB", (width * len(pictures), height), "white")
        for i, picture in enumerate(pictures):
            whole.paste(picture, (i * width, 0))
    return _save(whole, "scenes")


def paths() -> Path:
    """One held-out episode of the shipped table policy with exploration noise, knots against
    splines.
    """
    with tempfile.TemporaryDirectory() as name:
        noisy = ("--noise", str(NOISE), "--split", "test", "--seed", "1", "--episodes", "1")
        coordlog_command(
            "record", "--scene", "table", "--policy", "pretrained", *noisy, "--out", f"{name}/raw"
        )
        coordlog_command("smooth", f"{name}/raw", "--out", f"{name}/smoothed")
        (episode,) = Path(name, "smoothed").rglob("*.mcap")
        coordlog_command("plot", str(episode), "--out", f"{name}/paths.png")
        return _save(Image.open(f"{name}/paths.png").convert("RGB"), "paths")


def learning() -> Path | None:
    """Live learning curves of every scene that has one; None without any."""
    kept = [path for scene in tables.SCENES for path in curves.live(scene)]
    if not kept:
        return None
    with tempfile.TemporaryDirectory() as name:
        coordlog_command("plot", *map(str, kept), "--out", f"{name}/curves.png")
        return _save(Image.open(f"{name}/curves.png").convert("RGB"), "curves")


def _save(picture: Image.Image, name: str) -> Path:
    small = (
        picture.resize((WIDTH, round(picture.height * WIDTH / picture.width)))
        if picture.width > WIDTH
        else picture
    )
    path = IMAGES / f"{name}.png"
    small.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def coordlog_command(*arguments: str) -> None:
    """Run `coordlog` with these words, quietly.

    Raises:
        subprocess.CalledProcessError: if it fails.
    """
    subprocess.run(
        [sys.executable, "-m", "coordlog.cli", *arguments], check=True, stdout=subprocess.DEVNULL
    )


FIGURES = {"scenes": scenes, "curves": learning, "paths": paths}


def main(arguments: list[str] | None = None) -> None:
    """Draw what the command line names, or everything."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.figures", description=(__doc__ or "").split("\n", 1)[0]
    )
    parser.add_argument("figure", nargs="*", help=f"any of {', '.join(FIGURES)}; none: all")
    given = parser.parse_args(arguments)
    for name in given.figure or FIGURES:
        if name not in FIGURES:
            parser.error(f"unknown figure '{name}'; choose one of: {', '.join(FIGURES)}")
        print(
            FIGURES[name]()
            or f"{name}: nothing kept in {curves.FOLDER} yet; python -m experiments.curves ROW RUN keeps some"
        )


if __name__ == "__main__":
    main()
