"""What an operator can set about the service: arguments, or `LIFTWRIGHT_…` environment variables."""

from __future__ import annotations

from pydantic import Field

from workers.settings import WorkerSettings


class ServiceSettings(WorkerSettings):
    """Where the service listens and what it lets in."""

    host: str = "127.0.0.1"
    """There is no authentication: whoever reaches this address can post and read everything."""
    port: int = Field(default=8040, ge=0, le=65535)
    """0: any free one."""
    max_body_bytes: int = Field(default=2_000_000, ge=1000)
    """A larger body is refused [bytes]."""
    max_mesh_bytes: int = Field(default=20_000_000, ge=1000)
    """A larger mesh file is refused [bytes]."""
    max_scan_bytes: int = Field(default=100_000_000, ge=1000)
    """A scan whose files are larger together is refused [bytes]."""
    max_perceived: int = Field(default=2, ge=1)
    """So many scans are read and worked on at once; others wait [1]."""
    max_queued: int = Field(default=1000, ge=1)
    """With this many jobs unfinished, a new one is refused [1]."""
    max_wait_seconds: float = Field(default=60.0, ge=0.0)
    """Longest time that `Prefer: wait` is followed [s]."""
