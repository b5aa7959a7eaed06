"""A study whose service is killed: every point is found in the end, and none that was known is examined again."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from tests.support.samples import sample
from tests.support.service import FAKE_EXAMINER, FAKE_SOLVER, ServiceProcess, finished, running_service, task, wait_for

PLACES = sample(quick=1, whole=4)
POINTS = sample(quick=20, whole=60)


@pytest.fixture
def begun(tmp_path: Path) -> Path:
    """Where the numbers of points are written that an examiner begins with."""
    return tmp_path / "begun"


@pytest.fixture
def service(tmp_path: Path, begun: Path) -> Iterator[ServiceProcess]:
    examiner = json.dumps([*FAKE_EXAMINER, str(begun)])
    with running_service(tmp_path / "data", FAKE_SOLVER, study_command=examiner, study_slots=PLACES) as service:
        yield service


@pytest.mark.slow
def test_what_was_accepted_is_finished_and_what_was_known_is_not_examined_again(
    service: ServiceProcess, begun: Path
) -> None:
    axes = [{"pointer": "/cup/position/0", "min": -0.1, "max": 0.1, "count": POINTS}]
    with service.client() as client:
        posted = client.post("/v1/studies", json={"task": task(external_id="slow"), "axes": axes}).json()
        wait_for(lambda: client.get(posted["links"]["self"]).json()["known"] >= 8)
        examiners = service.descendants()
    service.kill()
    wait_for(lambda: not any(each.is_running() and each.status() != psutil.STATUS_ZOMBIE for each in examiners), 5)
    service.start()
    with service.client() as client:
        known = {point["index"]: point for point in client.get(posted["links"]["map"]).json()["points"]}
        assert len(known) >= 8
        study = finished(client, posted)
        assert (study["state"], study["known"]) == ("succeeded", POINTS)
        whole = {point["index"]: point for point in client.get(posted["links"]["map"]).json()["points"]}
        assert {index: whole[index] for index in known} == known
        assert finished(client, {"links": {"self": study["best_plan"]}})["outcome"] == "solved"
    examined = Counter(map(int, begun.read_text().split()))
    # The points at which it was killed were begun, and known to nobody.
    assert set(examined) == set(range(POINTS))
    assert sum(count - 1 for count in examined.values()) <= 2 * PLACES
    assert max(examined.values()) <= 2
