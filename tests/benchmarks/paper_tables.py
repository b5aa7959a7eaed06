"""Tables III and IV of paper B, as printed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperRow:
    """One task of the paper. Times in seconds, forces in newtons."""

    grips: int
    pushes: int
    dcsg_seconds: float
    reach_seconds: float
    """RV1: inverse kinematics and collisions."""
    balance_seconds: tuple[float, float, float, float, float]
    """RV2, per hold: min, max, mean, standard deviation; and the total."""
    nodes: int
    edges: int
    merge_seconds: float
    starts: int
    goals: int
    search_seconds: float
    length: int
    contact_changes: int
    largest_force: float
    dcsg_nodes: int = 151
    dcsg_edges: int = 2676

    @property
    def total_seconds(self) -> float:
        """All stages together."""
        stages = (self.dcsg_seconds, self.reach_seconds, self.balance_seconds[4], self.merge_seconds)
        return sum(stages) + self.search_seconds


PAPER = {
    "ab1": PaperRow(
        30, 64, 0.090, 498.1, (0.10, 3.84, 1.51, 0.76, 2983.4), 9583, 126279, 351.6, 8, 105, 19.87, 22, 3, 12.70
    ),
    "ab2": PaperRow(
        30, 64, 0.094, 499.9, (0.10, 3.62, 0.83, 0.69, 1642.7), 7323, 85476, 351.6, 8, 99, 18.63, 20, 3, 12.70
    ),
    "ab3": PaperRow(
        30, 64, 0.087, 534.1, (0.10, 4.22, 0.97, 0.80, 1912.1), 6129, 71954, 340.6, 7, 54, 4.31, 18, 4, 12.70
    ),
    "pb1": PaperRow(
        36, 72, 0.090, 665.1, (0.11, 4.52, 0.81, 0.63, 2143.1), 21552, 263039, 628.6, 10, 40, 32.35, 19, 3, 13.55
    ),
    "pb2": PaperRow(
        36, 72, 0.092, 671.9, (0.11, 4.83, 1.67, 0.91, 4421.1), 10116, 96763, 654.7, 6, 141, 11.42, 21, 3, 13.55
    ),
}
