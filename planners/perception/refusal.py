"""What is said of sensor data that nothing can be read from."""

from __future__ import annotations

from planners.errors import LiftwrightError


class ScanRefused(LiftwrightError):
    """Sensor data cannot be used; `part` names which: "description", "colour", "depth" or "cloud"."""

    def __init__(self, part: str, detail: str) -> None:
        self.part, self.detail = part, detail
        super().__init__(f"{part}: {detail}")
