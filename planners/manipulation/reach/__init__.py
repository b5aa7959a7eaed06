"""Reach: which hand has which hold at which pose of the plate, in which postures."""
