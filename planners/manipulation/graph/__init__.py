"""The Manipulation State Graph: its nodes, its edges' costs, and what was found to fail (paper B, V-A)."""
