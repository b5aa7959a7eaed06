"""Liftwright's planners: a pure library that turns a scene into a certified plan."""
