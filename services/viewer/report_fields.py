"""What the services report of their frames, described for the page and for `/metrics` by its declaration in wire.py alone."""

from functools import cache
from typing import Any, NamedTuple, get_type_hints

import msgspec

from vemlight.runtime import wire
from vemlight.runtime.channels import FRAMES, Instance, service_of

# By the last word of a field's name; counts have none.
UNITS = {"ms": "ms", "hz": "Hz", "frames": "frames", "ratio": "%", "depth": "%", "lux": "lux"}
KEPT_WORDS = {"depth"}  # that a label needs, too


class ReportField(NamedTuple):
    """A field of a service's report. `unit`: a value of UNITS, or empty. `is_loss`: growing is bad news."""

    name: str
    label: str
    unit: str
    meaning: str
    is_loss: bool


@cache
def report_fields(service: Instance) -> tuple[ReportField, ...]:
    """The fields of what `service` reports of its frames, in the order of their declaration; none where it reports nothing."""
    report = get_type_hints(wire.KINDS[FRAMES[service_of(service)].kind]).get("report")
    if report is None:
        return ()
    hints = get_type_hints(report, include_extras=True)
    return tuple(_field(name, hints[name]) for name in report.__struct_fields__)


def _field(name: str, hint: Any) -> ReportField:
    metas = [meta for meta in getattr(hint, "__metadata__", ()) if isinstance(meta, msgspec.Meta)]
    stem, _, last = name.rpartition("_")
    title = next((meta.title for meta in metas if meta.title), None)
    return ReportField(
        name=name,
        label=title or (stem if last in UNITS and last not in KEPT_WORDS else name).replace("_", " "),
        unit=UNITS.get(last, ""),
        meaning=next((meta.description for meta in metas if meta.description), ""),
        is_loss=any((meta.extra or {}).get("is_loss") for meta in metas),
    )
