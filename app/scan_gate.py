"""How many scans are in memory, and how many of them are worked on."""

from __future__ import annotations

from anyio import CapacityLimiter


class ScanGate:
    """Two limits: a sender who is slow takes up memory, but never the place of one whose scan is there."""

    def __init__(self, most_held: int, most_perceived: int) -> None:
        self.held = CapacityLimiter(most_held)
        """From the first byte that is read to the end of perception."""
        self.perceived = CapacityLimiter(most_perceived)
        """While the tool and the objects are looked for."""
