"""How many uploads of a kind are in memory, and how many of them are worked on."""

from __future__ import annotations

from anyio import CapacityLimiter


class UploadGate:
    """Two limits: a sender who is slow takes up memory, but never the place of one whose upload is there."""

    def __init__(self, most_held: int, most_worked: int) -> None:
        self.held = CapacityLimiter(most_held)
        """From the first byte that is read to the end of the work."""
        self.worked = CapacityLimiter(most_worked)
        """While something is made of it, on a thread."""
