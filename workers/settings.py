"""What an operator can set about storage and workers: arguments, or `LIFTWRIGHT_…` environment variables."""

from __future__ import annotations

import os
import socket
import sys
from ipaddress import IPv4Network, IPv6Network
from pathlib import Path
from typing import Self

from pydantic import Field, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

EMBEDDED_NAME = "embedded"
"""Of the one worker on SQLite: after a start it takes up its own jobs, whatever the host is called now."""
HANDOVERS_FOLDER = "handovers"
"""In the data directory."""
CELLS_FOLDER = "cells"
"""In the data directory."""
SOLVER_COMMAND = (sys.executable, "-m", "workers.solver.process")
STUDY_COMMAND = (sys.executable, "-m", "workers.solver.study_process")
FEASIBILITY_COMMAND = (sys.executable, "-m", "workers.solver.feasibility_process")


def _default_slots() -> int:
    """Half the cores: a plan uses one, its successor's process starts on another."""
    return max(1, (os.cpu_count() or 1) // 2)


class WorkerSettings(BaseSettings):
    """Where plans are kept and how many are worked on at once."""

    model_config = SettingsConfigDict(env_prefix="LIFTWRIGHT_", frozen=True, extra="ignore")

    data_dir: Path = Path("data")
    """Database (unless `database_url` is given), locks, handovers of tools, and documents that failed their
    certificate."""
    database_url: str | None = None
    """`postgresql://…`; None: SQLite in `data_dir`."""
    database_connections: int = Field(default=6, ge=3, le=100)
    """So many connections to PostgreSQL each process has at most [1]. A worker has two more: one proves that it lives,
    by one the engine listens."""
    frozen_seconds: float = Field(default=30.0, ge=1.0, le=3600.0)
    """A worker that is connected and has not proved for so long that it lives is frozen: others end its connection, and
    take its jobs over [s]. It must be longer than `watch_seconds` and `patience_seconds` together."""
    worker_name: str = Field(default_factory=socket.gethostname, pattern=r"^[A-Za-z0-9_.-]{1,128}$")
    """Unique and stable per worker process on PostgreSQL; a job belongs to the name until it ends."""
    worker_slots: int = Field(default_factory=_default_slots, ge=1, le=64)
    """Jobs at the same time [1]."""
    solver_command: tuple[str, ...] = SOLVER_COMMAND
    """Starts one solver process; see `workers.solver.process` for what it must speak."""
    study_slots: int = Field(default_factory=lambda: os.cpu_count() or 1, ge=1, le=64)
    """Parts of studies at the same time, beside the jobs; their processes stand back behind those of jobs [1]."""
    study_command: tuple[str, ...] = STUDY_COMMAND
    """Starts one process that examines points of studies; see `workers.solver.study_process`."""
    poll_seconds: float = Field(default=0.1, gt=0.0, le=10.0)
    """How often the queue is looked at [s]. Each look costs about 2 ms; parts of studies and messages of webhooks are
    looked for every 0.5 s, or as seldom. A large fleet wants seconds: see "many workers" in the measurements."""
    cancel_poll_seconds: float = Field(default=0.2, gt=0.0, le=1.0)
    """How often running jobs are checked for having been cancelled [s]."""
    crash_limit: int = Field(default=3, ge=1, le=10)
    """A job whose solver process died this often has failed [1]."""
    interruption_limit: int = Field(default=10, ge=1, le=1000)
    """A job that was begun anew this often because the whole worker died has failed [1]."""

    solver_seconds: float = Field(default=1800.0, gt=0.0, le=86400.0)
    """A job whose solver takes longer than this has failed [s]. Planning itself counts no time: this is for the day on
    which something hangs."""
    solver_memory_mb: int = Field(default=4096, ge=256)
    """So much memory a solver process may take for data [MiB]; a task that needs more has failed. One that waits for
    work has about 600."""
    solver_niceness: int = Field(default=10, ge=0, le=19)
    """How far solvers and their sessions stand back behind everything else on the machine, API and database above all
    (nice(1)): requests are answered soon while all cores plan, and an idle machine plans as fast."""
    watch_seconds: float = Field(default=2.0, gt=0.0, le=60.0)
    """How often a worker looks for jobs of workers that have died, and whether its own still are its own [s]."""
    patience_seconds: float = Field(default=5.0, ge=0.0, le=600.0)
    """So long a worker that should have proved that it lives, and could not, goes on with the jobs it has; then it
    stops them, because another worker may have them [s]."""
    retention_days: float | None = Field(default=None, gt=0.0)
    """Plans that ended longer ago than this are deleted [days]; None: kept for ever."""
    audit_days: float | None = Field(default=None, gt=0.0)
    """Entries of the audit log that are older are deleted [days]; None: kept for ever."""

    webhook_hosts: tuple[str, ...] = ()
    """Hosts that webhooks may lead to, also as patterns (`*.example.com`); none: any."""
    webhook_networks: tuple[IPv4Network | IPv6Network, ...] = ()
    """Private networks that webhooks may lead into, and without TLS; none: public addresses only."""
    webhook_ca_file: Path | None = None
    """Certificates of authorities that are trusted with webhooks; None: those of the system."""
    webhook_retry_seconds: tuple[float, ...] = (5, 300, 1800, 7200, 18000, 36000, 50400, 72000, 86400)
    """Pauses between tries to deliver a message [s]; after the last one it has failed."""
    webhook_timeout_seconds: float = Field(default=15.0, gt=0.0, le=60.0)
    """Longest time that a try may take [s]."""

    @model_validator(mode="after")
    def _stops_before_it_counts_as_frozen(self) -> Self:
        if self.frozen_seconds <= self.watch_seconds + self.patience_seconds:
            raise ValueError(
                f"frozen_seconds ({self.frozen_seconds:g}) must be longer than watch_seconds and patience_seconds "
                f"together ({self.watch_seconds + self.patience_seconds:g})"
            )
        return self

    @property
    def embedded(self) -> bool:
        """Whether everything runs in one process on SQLite."""
        return self.database_url is None

    @property
    def handovers_dir(self) -> Path:
        """Where handover databases are kept: on each worker's own disk, whatever the database is."""
        return self.data_dir.resolve() / HANDOVERS_FOLDER

    @property
    def cells_dir(self) -> Path:
        """Where cells of one's own are unpacked, on each machine's own disk; what is there can be made again."""
        return self.data_dir.resolve() / CELLS_FOLDER

    @property
    def executor_name(self) -> str:
        """The name under which jobs belong to this worker."""
        return EMBEDDED_NAME if self.embedded else self.worker_name
