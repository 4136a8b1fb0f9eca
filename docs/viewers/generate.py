"""Write the humanoid's layouts for other viewers again: python docs/viewers/generate.py."""

import json
from pathlib import Path

from coordlog.mjcf import compile_model, compose
from coordlog.sim.env import hinges
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import SCENES
from coordlog.view.plain import APPLICATION, foxglove_layout, plain_blueprint


def main(folder: Path) -> None:
    """Write `humanoid.rbl` and `humanoid.foxglove.json` into a folder."""
    scene = SCENES["table"]
    arms = [arm.name for arm in scene.robot.arms]
    joints = [joint["name"] for joint in hinges(compile_model(compose(scene, EnvConfig())))]
    plain_blueprint(arms).save(APPLICATION, str(folder / "humanoid.rbl"))
    layout = json.dumps(foxglove_layout(arms, joints, scene.robot.action_joints), indent=1)
    (folder / "humanoid.foxglove.json").write_text(layout + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(__file__).parent)
