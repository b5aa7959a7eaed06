"""What a cell can do: whether it can be begun with at all, and what its arms reach and bear where."""
