"""What a monitoring system reads: figures of all workers from the database, and of this process's requests."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence

from prometheus_client import GC_COLLECTOR, PLATFORM_COLLECTOR, PROCESS_COLLECTOR, Histogram
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.multiprocess import MultiProcessCollector
from prometheus_client.registry import Collector

from workers.stores import totals
from workers.stores.job_queue import Depth
from workers.stores.totals import Total

REQUEST_SECONDS = Histogram(
    "liftwright_request_seconds",
    "Time from a request to the end of its answer",
    ["method", "route", "status"],
    buckets=(0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0),
    registry=None,
)
"""Event streams and requests that wait for a job take as long as these do."""
SHARED_VARIABLE = "PROMETHEUS_MULTIPROC_DIR"
"""Names a folder in which the processes of one service keep what they count; set before this module is loaded."""
COUNTERS = {
    totals.DOCUMENT: ("liftwright_documents_made", "Plan documents made", "outcome"),
    totals.FAILURE: ("liftwright_failed_jobs", "Jobs that ended without a document", "why"),
    totals.SOLVER_DEATH: ("liftwright_solver_deaths", "Solver processes that ended without an answer", None),
    totals.STUDY_POINT: ("liftwright_study_points", "Points of studies examined", "outcome"),
    totals.TAKEOVER: ("liftwright_jobs_begun_anew", "Jobs whose worker had died or lost them", None),
}


def process_metrics() -> tuple[Collector, ...]:
    """Return what is told of requests, by all processes of the service together, and of this process."""
    requests: Collector = REQUEST_SECONDS
    if SHARED_VARIABLE in os.environ:
        requests = MultiProcessCollector(None)
    return (requests, PROCESS_COLLECTOR, PLATFORM_COLLECTOR, GC_COLLECTOR)


class ServiceMetrics(Collector):
    """The state of the fleet at one moment."""

    def __init__(self, depth: Depth, parts: Depth, stored: Mapping[str, int], counted: Sequence[Total]) -> None:
        """Take what is told.

        Args:
            depth: of the queue of jobs.
            parts: of the queue of parts of studies.
            stored: how many documents are there, by outcome.
            counted: what was ever counted.
        """
        self._depth, self._parts, self._stored, self._counted = depth, parts, stored, counted

    def collect(self) -> Iterator[Metric]:
        """Yield every family of metrics."""
        jobs = GaugeMetricFamily("liftwright_jobs", "Unfinished jobs", labels=["state"])
        jobs.add_metric(["queued"], self._depth.queued)
        jobs.add_metric(["delayed"], self._depth.delayed)
        jobs.add_metric(["running"], self._depth.running)
        yield jobs
        parts = GaugeMetricFamily("liftwright_study_parts", "Unfinished parts of studies", labels=["state"])
        parts.add_metric(["queued"], self._parts.queued)
        parts.add_metric(["running"], self._parts.running)
        yield parts
        documents = GaugeMetricFamily("liftwright_documents", "Stored plan documents", labels=["outcome"])
        for outcome, count in self._stored.items():
            documents.add_metric([outcome], count)
        yield documents
        for name, (metric, help_text, label) in COUNTERS.items():
            family = CounterMetricFamily(metric, help_text, labels=[] if label is None else [label])
            for total in self._counted:
                if total.name == name:
                    family.add_metric([] if label is None else [total.label], total.count)
            yield family
        yield from self._stages()

    def _stages(self) -> Iterator[Metric]:
        runs = CounterMetricFamily("liftwright_stages", "Stages of jobs that led to a document", labels=["stage"])
        seconds = CounterMetricFamily("liftwright_stage_seconds", "Time these stages took", labels=["stage"])
        for total in self._counted:
            if total.name == totals.STAGE:
                runs.add_metric([total.label], total.count)
                seconds.add_metric([total.label], total.seconds)
        yield runs
        yield seconds
