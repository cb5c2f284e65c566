"""`/metrics`: the report as Prometheus text. One prefix, base units, `_total` for what only grows; no light's id is a label."""

import os
import resource
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from vemlight.viewer.liveness import STATES

OUTCOMES = {"done": "frames", "skipped": "skipped", "dropped": "dropped", "refused": "refused"}
PIXELS = {"black": "black_pixels", "saturated": "saturated_pixels", "invalid": "invalid_cells"}
_started_s = time.time()


def metrics(report: dict[str, Any]) -> str:
    """The text, version 0.0.4 of the exposition format. `report` is `ViewerState.summary`."""
    rows = report["services"]
    frames = [({"stage": row["service"], "outcome": o}, row.get(key, 0)) for row in rows for o, key in OUTCOMES.items()]
    states = [({"stage": str(row["service"]), "state": str(state)}, int(row["state"] == state)) for row in rows for state in STATES]
    pixels = [({"kind": kind}, rows[0].get(key, 0)) for kind, key in PIXELS.items()]
    steps = [({**stage, "quantile": "0.5"}, value) for stage, value in _of(rows, "step_ms", 1e-3)]
    return "".join(
        (
            _family("vemlight_frames_total", "counter", "Frames of a stage by what became of them.", frames),
            _family("vemlight_frame_rate_hertz", "gauge", "Frames a second, over the last two seconds.", _of(rows, "rate_hz", 1)),
            _family("vemlight_frame_age_seconds", "gauge", "Age of the newest frame's light.", _of(rows, "age_ms", 1e-3)),
            _family("vemlight_stage_duration_seconds", "summary", "Time for one frame, median of the last ones.", steps),
            _family("vemlight_stage_restarts_total", "counter", "How often a stage was started again.", _of(rows, "restarts", 1)),
            _family("vemlight_stage_state", "gauge", "1 for the state that a stage is in.", states),
            _family("vemlight_filter_delay_seconds", "gauge", "How far the filter holds the light back.", _of(rows[1:2], "delay_ms", 1e-3)),
            _family("vemlight_filter_delay_frames", "gauge", "The same, in frames.", _of(rows[1:2], "delay_frames", 1)),
            _family("vemlight_map_cells", "gauge", "Of the newest map: cells and pixels set aside, by kind.", pixels),
            _family("vemlight_lights", "gauge", "Lights of the newest frame.", [({}, report["lights"]["count"])]),
            _family("vemlight_flicker_hertz", "gauge", "Beat of lamps with the frame rate, or 0.", [({}, report["lights"]["flicker_hz"])]),
            _family("vemlight_pages", "gauge", "Pages and streams that are open.", [({}, report["pages"])]),
            *_own_process(),
        )
    )


def _of(rows: list[dict[str, Any]], key: str, to_base_unit: float) -> list[tuple[dict[str, str], float]]:
    return [({"stage": row["service"]}, row[key] * to_base_unit) for row in rows if row.get(key) is not None]


def _family(name: str, kind: str, meaning: str, samples: Iterable[tuple[dict[str, str], float]]) -> str:
    lines = [f"# HELP {name} {meaning}", f"# TYPE {name} {kind}"]
    for labels, value in samples:
        inside = ",".join(f'{key}="{text}"' for key, text in labels.items())
        lines.append(f"{name}{{{inside}}} {value:.10g}" if inside else f"{name} {value:.10g}")
    return "\n".join(lines) + "\n"


def _own_process() -> list[str]:
    """The viewer's own process, under the names that every Prometheus client uses."""
    pages_held = int(Path("/proc/self/statm").read_text().split()[1])
    used = resource.getrusage(resource.RUSAGE_SELF)
    files = len(os.listdir("/proc/self/fd"))
    return [
        _family("process_cpu_seconds_total", "counter", "User and system time.", [({}, used.ru_utime + used.ru_stime)]),
        _family("process_resident_memory_bytes", "gauge", "Memory in use.", [({}, pages_held * resource.getpagesize())]),
        _family("process_open_fds", "gauge", "Open files and sockets.", [({}, files)]),
        _family("process_start_time_seconds", "gauge", "When it began, realtime.", [({}, _started_s)]),
    ]
