"""Geometry of a compiled model: inverse kinematics, balance, clearance and bounds on motion."""
