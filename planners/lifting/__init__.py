"""Lifting the plate together with a lifter that somebody else operates: paper B, Section VI."""
