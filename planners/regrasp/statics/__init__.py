"""Statics: whether cup, fingers and joints bear what they carry, at rest and in timed motion."""
