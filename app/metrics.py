"""What can be counted of the service, in the form that Prometheus collects."""

from __future__ import annotations

from collections.abc import Mapping

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest

from jointplay.catalogue.diagnosing.answer import Diagnosis

METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
OTHER = "other"
NO_ROUTE = "none"
SECONDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 120.0)
"""Upper bounds of the classes of times [s]."""


class Metrics:
    """Counts of one running service; every label has few values, which no client can add to.

    Attributes
    ----------
    registry : CollectorRegistry
        Of this service alone.
    """

    def __init__(self) -> None:
        self.registry = CollectorRegistry()

        def counter(name: str, says: str, *labels: str) -> Counter:
            return Counter(f"jointplay_{name}", says, labels, registry=self.registry)

        def histogram(name: str, says: str, *labels: str) -> Histogram:
            return Histogram(f"jointplay_{name}", says, labels, registry=self.registry, buckets=SECONDS)

        self._requests = counter("http_requests", "Requests answered.", "method", "route", "status")
        self._request_seconds = histogram(
            "http_request_duration_seconds", "From a request to the end of its answer.", "method", "route"
        )
        self._diagnoses = counter("diagnoses", "Diagnoses made.", "effort", "mode", "verdict")
        self._refused = counter("uploads_refused", "Uploads that were not taken.", "reason")
        self._deliveries = counter("webhook_attempts", "Attempts to tell a webhook something.", "outcome")
        self._queue_seconds = histogram("task_queue_seconds", "Time that tasks waited for a worker.", "task")
        self._worker_seconds = histogram("task_worker_seconds", "Time of tasks in a worker.", "task", "outcome")
        self._met = counter("damage_met", "Damaged rows and recordings that somebody asked for.", "problem")
        self._scrubbed = counter("scrubbed_bytes", "What was looked through for damage.")
        self._damaged = Gauge(
            "jointplay_damaged",
            "What the last look found damaged.",
            ["kind"],
            registry=self.registry,
        )
        self._looked = Gauge(
            "jointplay_scrub_ended_timestamp_seconds", "When the last look ended; 0 before.", registry=self.registry
        )
        ProcessCollector(registry=self.registry)  # of the server itself, where the system tells

    def count_answer(self, method: str, route: str | None, status: int, seconds: float) -> None:
        """Count an answer."""
        labels = (method if method in METHODS else OTHER, route or NO_ROUTE)
        self._requests.labels(*labels, str(status)).inc()
        self._request_seconds.labels(*labels).observe(seconds)

    def count_refusal(self, reason: str) -> None:
        """Count an upload that was refused, by the kind of problem."""
        self._refused.labels(reason).inc()

    def count_diagnosis(self, result: Diagnosis) -> None:
        """Count a diagnosis."""
        self._diagnoses.labels(result.effort, result.mode.used, result.verdict).inc()

    def count_delivery(self, outcome: str) -> None:
        """Count an attempt of a webhook: ``delivered``, ``failed``, or ``given_up`` after the last that failed."""
        self._deliveries.labels(outcome).inc()

    def count_damage(self, problem: str, count: int = 1) -> None:
        """Count damaged things that somebody asked for, by the kind of problem."""
        self._met.labels(problem).inc(count)

    def count_scrubbed(self, size: int) -> None:
        """Count bytes that were looked through for damage."""
        self._scrubbed.inc(size)

    def tell_damage(self, found: Mapping[str, int], moment: float) -> None:
        """Tell what a look through everything found damaged, by kind, and when it ended [s since 1970]."""
        for kind, count in found.items():
            self._damaged.labels(kind).set(count)
        self._looked.set(moment)

    def count_wait(self, task: str, seconds: float) -> None:
        """Count a task that got a worker."""
        self._queue_seconds.labels(task).observe(seconds)

    def count_work(self, task: str, outcome: str, seconds: float) -> None:
        """Count a task that a worker is done with."""
        self._worker_seconds.labels(task, outcome).observe(seconds)

    def text(self) -> bytes:
        """Return all of it in the text format of Prometheus."""
        return generate_latest(self.registry)
