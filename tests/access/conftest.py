"""A running service that asks for keys, and some keys."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import httpx
import pytest

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from app.settings import ServiceSettings
from tests.support.service import FAKE_EXAMINER, FAKE_SOLVER
from tests.support.serving import served


@dataclass(frozen=True)
class GuardedService:
    """Where it is, how it is set, and a key of each kind."""

    address: str
    settings: ServiceSettings
    keys: dict[str, str]

    def client(self, name: str | None) -> httpx.Client:
        headers = {} if name is None else {"Authorization": f"Bearer {self.keys[name]}"}
        return httpx.Client(base_url=self.address, headers=headers, timeout=30.0)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuardedService]:
    settings = ServiceSettings(
        data_dir=tmp_path_factory.mktemp("data"),
        solver_command=FAKE_SOLVER,
        study_command=FAKE_EXAMINER,
        worker_slots=1,
        body_stall_seconds=0.3,
    )
    keys = {
        "reader": issue_key(settings, "mes", Scope.READ, None),
        "writer": issue_key(settings, "mes", Scope.WRITE, None),
        "stranger": issue_key(settings, "other", Scope.WRITE, None),
        "admin": issue_key(settings, "it", Scope.ADMIN, None),
        "expired": issue_key(settings, "mes", Scope.ADMIN, -1.0),
    }
    with served(settings) as address:
        yield GuardedService(address, settings, keys)
