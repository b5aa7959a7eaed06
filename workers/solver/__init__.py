"""Solver processes: how they are started, what they are asked, how far they are, and what they need warm."""
