"""The commands, one module each: the only place where the rooms meet.

A module here imports a room inside its function, so that `coordlog --help` loads none of them.
"""
