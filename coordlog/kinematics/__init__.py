"""Geometry of a compiled model: inverse kinematics, balance, clearance and bounds on motion.

Where bodies are, MuJoCo alone computes. Four classes ask it, each with data of its own because each
has the model set up otherwise or runs other stages:

    Reach         which posture brings the palms to their goals: contacts listed before they touch
    SceneChecker  how near postures are to touching: contacts listed within the clearance asked for
    Inverse       torques and balance of the joints in motion: velocities and forces too
    Geometry      where every shape is, for pictures: no contacts

A checker and `Inverse` are told the action joints alone: the rest of a posture is the log's, of
`Logged`, and the soles that stand are those of `Footing`.
"""
