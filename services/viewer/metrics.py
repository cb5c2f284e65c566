"""`/metrics`: the viewer's summary for Prometheus. One prefix, base units, `_total` for what only grows; no light's id is a label."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from vemlight.runtime import wire
from vemlight.viewer.liveness import STATES
from vemlight.viewer.report_fields import ReportField

OUTCOMES = {"done": "frames", "skipped": "skipped", "dropped": "dropped", "refused": "refused", "unwritten": "unwritten"}
# Of report_fields.UNITS. What the page shows in % is a ratio here, as its name says.
BASE_UNITS = {"ms": ("seconds", 1e-3), "Hz": ("hertz", 1.0), "lux": ("lux", 1.0), "frames": ("frames", 1.0), "%": ("", 1.0), "": ("", 1.0)}


def registry(summary: Callable[[], dict[str, Any]]) -> CollectorRegistry:
    """What `prometheus_client.generate_latest` writes: the summary's metrics at that moment and those of this process."""
    metrics = CollectorRegistry()
    metrics.register(SummaryCollector(summary))
    ProcessCollector(registry=metrics)
    return metrics


class SummaryCollector(Collector):
    """The metrics of `ViewerState.summary`."""

    def __init__(self, summary: Callable[[], dict[str, Any]]) -> None:
        self._summary = summary

    def describe(self) -> list[Metric]:
        return []  # else the registry collects once at the start to find the names

    def collect(self) -> Iterator[Metric]:
        summary = self._summary()
        rows = summary["services"]
        frames = CounterMetricFamily("vemlight_frames_total", "Frames of a stage by what became of them.", labels=["stage", "outcome"])
        states = GaugeMetricFamily("vemlight_stage_state", "1 for the state that a stage is in.", labels=["stage", "state"])
        restarts = CounterMetricFamily("vemlight_stage_restarts_total", "How often a stage was restarted.", labels=["stage"])
        for row in rows:
            for outcome, key in OUTCOMES.items():
                frames.add_metric([row["service"], outcome], row.get(key, 0))
            for state in STATES:
                states.add_metric([row["service"], state], row["state"] == state)
            restarts.add_metric([row["service"]], row.get("restarts", 0))
        yield from (frames, states, restarts)
        yield _gauge("vemlight_frame_rate_hertz", "Frames a second, over the last two seconds.", rows, "rate_hz", 1.0)
        yield _gauge("vemlight_frame_age_seconds", "Age of the newest frame's light.", rows, "age_ms", 1e-3)
        yield _durations(rows)
        yield from _report_metrics(rows, summary["report_fields"])
        yield GaugeMetricFamily("vemlight_lights", "Lights of the newest frame.", summary["light_count"])
        yield GaugeMetricFamily("vemlight_pages", "Pages and streams that are open.", summary["pages"])


def _gauge(name: str, meaning: str, rows: Iterable[dict[str, Any]], key: str, to_base_unit: float) -> GaugeMetricFamily:
    """A value of every stage that has it."""
    gauge = GaugeMetricFamily(name, meaning, labels=["stage"])
    for row in rows:
        if row.get(key) is not None:
            gauge.add_metric([row["service"]], row[key] * to_base_unit)
    return gauge


def _durations(rows: Iterable[dict[str, Any]]) -> HistogramMetricFamily:
    """How long the stages took for their frames."""
    histogram = HistogramMetricFamily("vemlight_stage_duration_seconds", "Time for one frame.", labels=["stage"])
    for row in rows:
        if "step_counts" in row:
            bounds = [*(str(bound_ms / 1e3) for bound_ms in wire.STEP_BOUNDS_MS), "+Inf"]
            counts = row["step_counts"]
            cumulative = [(bound, sum(counts[: k + 1])) for k, bound in enumerate(bounds)]
            histogram.add_metric([row["service"]], cumulative, row["step_total_ms"] / 1e3)
    return histogram


def _report_metrics(rows: Iterable[dict[str, Any]], fields: dict[str, list[dict[str, Any]]]) -> Iterable[GaugeMetricFamily]:
    """The fields of the services' reports: `vemlight_SERVICE_NAME_UNIT`, of several of a kind each with a label `name`."""
    gauges: dict[str, GaugeMetricFamily] = {}
    for row in rows:
        service, _, name = row["service"].partition(".")
        for field in (ReportField(**each) for each in fields.get(row["service"], ())):
            unit, to_base_unit = BASE_UNITS[field.unit]
            stem = "_".join([*field.name.split("_")[:-1], unit]) if unit else field.name
            meaning = f"{field.meaning[:1].upper()}{field.meaning[1:]}."
            family = f"vemlight_{service}_{stem}"
            gauge = gauges.setdefault(family, GaugeMetricFamily(family, meaning, labels=["name"] if name else []))
            value = row.get("report", {}).get(field.name)
            if value is not None:
                gauge.add_metric([name] if name else [], value * to_base_unit)
    return gauges.values()
