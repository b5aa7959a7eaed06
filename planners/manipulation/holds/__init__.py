"""Holds: grips and pushes along the rim of a plate (paper B, IV-B)."""
