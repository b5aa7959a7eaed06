"""What an operator can set about the service: arguments, or `LIFTWRIGHT_…` environment variables."""

from __future__ import annotations

from ipaddress import IPv4Network, IPv6Network, ip_address
from typing import Literal

from pydantic import Field

from workers.settings import FEASIBILITY_COMMAND, WorkerSettings


class ServiceSettings(WorkerSettings):
    """Where the service listens and what it lets in."""

    host: str = "127.0.0.1"
    """Another than this machine's own needs keys (`liftwright keys issue`)."""
    port: int = Field(default=8040, ge=0, le=65535)
    """0: any free one."""
    api_processes: int = Field(default=1, ge=1, le=64)
    """So many processes answer requests at this address; all but the first end with it [1]."""
    allowed_hosts: tuple[str, ...] = ()
    """Names by which the service is called, without ports; others are answered with 421. None: this machine's own on a
    loopback address, any elsewhere."""
    trusted_proxies: tuple[IPv4Network | IPv6Network, ...] = ()
    """Networks of proxies whose `X-Forwarded-For` and `X-Forwarded-Proto` are believed; none: nobody's."""
    max_connections: int = Field(default=1000, ge=16)
    """So many connections each API process holds; half as many as it may open files at most [1]."""
    head_seconds: float = Field(default=10.0, gt=0.0)
    """A connection on which no whole head of a request has come for so long is closed [s]."""
    write_seconds: float = Field(default=30.0, gt=0.0)
    """A connection of which its client has taken nothing for so long, though there is something to send, is closed
    [s]."""
    max_body_bytes: int = Field(default=2_000_000, ge=1000)
    """A larger body is refused [bytes]."""
    max_mesh_bytes: int = Field(default=20_000_000, ge=1000)
    """A larger mesh file is refused [bytes]."""
    max_cell_bytes: int = Field(default=32_000_000, ge=1000)
    """A larger zip or document of a cell is refused [bytes]."""
    max_scan_bytes: int = Field(default=100_000_000, ge=1000)
    """A scan whose files are larger together is refused [bytes]."""
    max_perceived: int = Field(default=2, ge=1)
    """So many scans are worked on at once; others wait [1]."""
    max_scans_held: int = Field(default=6, ge=1)
    """So many scans are received, held in memory or worked on at once; of others nothing is read yet [1]."""
    work_memory_mb: int = Field(default=2048, ge=512)
    """So much memory a process may take for data that perceives one scan, makes one recording, writes one program or
    looks at one cell [MiB]; what needs more is refused."""
    max_meshes_covered: int = Field(default=2, ge=1)
    """So many mesh files are read and covered with convex parts at once; others wait [1]."""
    max_meshes_held: int = Field(default=6, ge=1)
    """So many mesh files are received, held in memory or worked on at once; of others nothing is read yet [1]."""
    max_queued: int = Field(default=1000, ge=1)
    """With this many jobs unfinished that may be begun, a new one is refused [1]."""
    max_queued_of_owner: int = Field(default=500, ge=1)
    """So many of them may be one owner's, where keys tell owners apart [1]."""
    max_study_points: int = Field(default=1000, ge=1)
    """A study with more is refused [1]."""
    max_studies: int = Field(default=20, ge=1)
    """With this many studies unfinished, a new one is refused [1]."""
    max_studies_of_owner: int = Field(default=10, ge=1)
    """So many of them may be one owner's, where keys tell owners apart [1]."""
    max_delayed: int = Field(default=200, ge=0)
    """With this many jobs of one owner that wait for their start, another such one is refused [1]."""
    max_watchers: int = Field(default=24, ge=1)
    """So many viewers and editors are open at each API process, each with a scene of some 10 MB [1]."""
    max_watchers_of_owner: int = Field(default=8, ge=1)
    """So many of one owner's, where keys tell owners apart [1]."""
    max_followers: int = Field(default=500, ge=1)
    """So many event streams and `Prefer: wait` are open at each API process; half of `max_connections` at most [1]."""
    max_followers_of_owner: int = Field(default=200, ge=1)
    """So many of one owner's, where keys tell owners apart [1]."""
    max_lifts_kept: int = Field(default=2, ge=0, le=64)
    """For so many editors at each API process the graph of their lift is kept, in a process of some 300 MB each, by
    which it is told at once whether a change leaves a way [1]; 0: for none."""
    feasibility_command: tuple[str, ...] = FEASIBILITY_COMMAND
    """Starts one of these processes; see `workers.solver.feasibility_process`."""
    max_recordings_waiting: int = Field(default=8, ge=0)
    """With so many recordings that wait to be made, the recording of a further plan is refused [1]."""
    recordings_mb: int = Field(default=250, ge=0)
    """So much of what was recorded is kept in the data directory, and not made again [MiB]."""
    max_webhooks: int = Field(default=20, ge=0)
    """So many webhooks an owner may have [1]."""
    authentication: Literal["auto", "required"] = "auto"
    """Whether keys are asked for. auto: once there is one, or if `host` is not this machine's own."""
    metrics_without_key: bool = False
    """Whether `/metrics` is answered to whoever reaches the port, by whatever name, as `/livez` is: what collects
    metrics from containers finds them by address, and has no key. They tell how much is planned, and nothing of it."""
    requests_per_second: float = Field(default=100.0, gt=0.0)
    """So often a key may be used in the long run, at each API process [1/s]."""
    request_burst: int = Field(default=200, ge=1)
    """So often at once [1]."""
    body_stall_seconds: float = Field(default=10.0, gt=0.0)
    """A body of which nothing comes for so long is given up [s]."""
    body_seconds: float = Field(default=60.0, gt=0.0)
    """Longest time that a body may take in all [s]."""
    max_wait_seconds: float = Field(default=60.0, ge=0.0)
    """Longest time that `Prefer: wait` is followed [s]."""

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach the service."""
        if self.host == "localhost":
            return True
        try:
            return ip_address(self.host).is_loopback
        except ValueError:
            return False
