"""State graphs, their search, and why parts of them fell. Shared by both planners."""
