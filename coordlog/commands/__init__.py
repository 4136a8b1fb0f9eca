"""The commands, one module each: options in, what the API found out, and an exit code.

A module here imports a room inside its function, so that `coordlog --help` loads none of them.
"""
