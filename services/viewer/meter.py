"""The light meter: what the newest map and lights measure, worked out once for all pages, when one asks.

Luminance is in cd/m2 where the map is calibrated or the page names a scale, else relative, in the map's own unit.
"""

import struct
import threading
from typing import Any, NamedTuple

import msgspec
import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.colour_temperature import colour_temperature
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.glare import VALID_FROM_LX, glare_probability, glare_sources, grade_of
from vemlight.light.map_elements import MapElements, elements_from_map, plane_irradiance
from vemlight.light.sphere import direction_from_angles
from vemlight.runtime import wire

BINS_PER_STOP = 4  # of the histogram
MAX_STOPS = 32  # of the histogram, from the brightest down: more than any camera or eye takes in
TOP = 0.98  # of the highest value: where pixels are clipped, cells from here on count as clipped; 0.95 to 0.999 would do
MAX_DIRECTIONS = 64  # remembered for one map: one for each page
# rows, columns, coverage (1: sphere), log2 of the luminance of code 1, stops a code; then the code of each cell, 0 black, 255 clipped
CELLS_HEAD = struct.Struct("<HHI2f")
HIGHEST_CODE = 254
BRIGHTEST = 1e30  # what is brighter counts as so bright, as in the sampler: sums of it are finite in float32


class Look(NamedTuple):
    """Where a meter looks, degrees: azimuth from +X towards +Y, elevation above the horizon. scale: cd/m2 a unit for maps without it."""

    azimuth: float
    elevation: float
    scale: float = 0.0

    @property
    def direction(self) -> np.ndarray:
        """Unit vector (3,) float64."""
        return direction_from_angles(np.radians(90 - self.elevation), np.radians(self.azimuth))

    @property
    def up(self) -> np.ndarray:
        """What is above for who looks there, (3,), also at the zenith."""
        return direction_from_angles(np.radians(-self.elevation), np.radians(self.azimuth))


class LightColours:
    """Illuminance, colour temperature and Duv of lights, worked out when they are first asked for."""

    def __init__(self, ids: np.ndarray, irradiance: np.ndarray) -> None:
        self._ids, self._irradiance = ids, irradiance
        self._rows: list[tuple[int, float, float | None, float | None]] | None = None

    def rows(self, scale: float) -> list[dict[str, Any]]:
        """One for each light, the strongest first. Illuminance is that of a plane which faces it, in the map's unit times `scale`."""
        if self._rows is None:
            facing = luminance_from_rgb(self._irradiance.astype(np.float64))
            temperature, duv = colour_temperature(self._irradiance)
            order = np.argsort(-facing, kind="stable")
            self._rows = [(int(self._ids[k]), float(facing[k]), _number(temperature[k], 0), _number(duv[k], 4)) for k in order]
        return [
            {"id": light, "illuminance": facing * scale, "temperature_k": temperature, "duv": duv}
            for light, facing, temperature, duv in self._rows
        ]


class MapReadings:
    """What one map measures."""

    def __init__(self, header: wire.MapMessage, environment: EnvironmentMap) -> None:
        self._header = header
        self._elements = elements_from_map(environment._replace(radiance=np.minimum(environment.radiance, np.float32(BRIGHTEST))))
        self._luminance = luminance_from_rgb(self._elements.radiance)
        self._clipped = clipped_elements(self._elements, header.report.saturated_pixels)
        self._whole = self._of_map()
        self._seen: dict[Look, dict[str, Any]] = {}

    def _of_map(self) -> dict[str, Any]:
        header, elements, luminance = self._header, self._elements, self._luminance
        whole = elements.solid_angles.sum()
        irradiance = elements.solid_angles @ elements.radiance
        return {
            "schema": "vemlight.meter/1", "sequence": header.stamp.sequence, "time_s": header.stamp.time_s, "coverage": header.coverage,
            "cell_degrees": round((90 if header.coverage == "hemisphere" else 180) / elements.rows, 3),
            "mean": float(luminance_from_rgb(irradiance) / whole), "highest": float(luminance.max(initial=0)),
            "black": float(elements.solid_angles[luminance <= 0].sum() / whole),
            "clipped": float(elements.solid_angles[self._clipped].sum() / whole), "clipped_pixels": header.report.saturated_pixels,
            "histogram": histogram(luminance, elements.solid_angles), "whole": _colour(irradiance),
        }  # fmt: skip

    def seen_from(self, look: Look) -> dict[str, Any]:
        """All readings, with those of the plane that faces `look` and of an eye that looks there."""
        if look not in self._seen:
            if len(self._seen) >= MAX_DIRECTIONS:
                self._seen.clear()
            self._seen[look] = self._whole | self._of_look(look)
        return self._seen[look]

    def _of_look(self, look: Look) -> dict[str, Any]:
        scale = self._header.luminance_scale or look.scale
        irradiance = plane_irradiance(self._elements, look.direction)
        illuminance = float(luminance_from_rgb(irradiance)) * (scale or 1)
        plane = {"azimuth": look.azimuth, "elevation": look.elevation, "illuminance": illuminance, **_colour(irradiance)}
        glare = None
        if scale:
            sources = glare_sources(self._elements, self._luminance.astype(np.float64) * scale, look.direction)
            probability = glare_probability(illuminance, sources, look.direction, look.up)
            glare = {
                "dgp": probability, "grade": grade_of(probability), "sources": len(sources.luminance),
                "valid": illuminance >= VALID_FROM_LX,
            }  # fmt: skip
        calibrated = "map" if self._header.luminance_scale else "page" if scale else None
        return {"scale": scale or None, "scale_from": calibrated, "plane": plane, "glare": glare}

    def cells(self) -> bytes:
        """The luminance of each cell, in codes that are even in stops, as CELLS_HEAD says."""
        elements = self._elements
        light = np.bincount(elements.cells, self._luminance * elements.solid_angles, elements.rows * elements.cols)
        level = light / np.bincount(elements.cells, elements.solid_angles, elements.rows * elements.cols)
        lit = level > 0
        stops = np.log2(np.where(lit, level, 1))
        highest = float(stops[lit].max()) if lit.any() else 0.0
        lowest = max(float(stops[lit].min()), highest - MAX_STOPS) if lit.any() else 0.0
        step = max(highest - lowest, 1e-3) / (HIGHEST_CODE - 1)
        codes = np.where(lit, np.clip(np.rint(1 + (stops - lowest) / step), 1, HIGHEST_CODE), 0).astype(np.uint8)
        codes[elements.cells[self._clipped]] = 255
        coverage = ("hemisphere", "sphere").index(self._header.coverage)
        return CELLS_HEAD.pack(elements.rows, elements.cols, coverage, lowest, step) + codes.tobytes()


class Meter:
    """One for the process: frames go in, readings come out as bytes. Threads may ask; one works at a time."""

    def __init__(self) -> None:
        self._map: tuple[wire.MapMessage, EnvironmentMap] | None = None
        self._lights = LightColours(np.zeros(0, np.int64), np.zeros((0, 3), np.float32))
        self._read: tuple[Any, MapReadings] | None = None
        self._lock = threading.Lock()

    def take_map(self, header: wire.MapMessage, environment: EnvironmentMap) -> None:
        """Keeps the newest map."""
        self._map = header, environment

    def take_lights(self, ids: np.ndarray, irradiance: np.ndarray) -> None:
        """Keeps the newest lights: ids (n,) and irradiance (n, 3)."""
        self._lights = LightColours(ids, irradiance)

    def readings(self, look: Look) -> bytes | None:
        """`vemlight.meter/1` as JSON; None before the first map."""
        with self._lock:
            readings = self._newest()
            if readings is None:
                return None
            seen = readings.seen_from(look)
            return msgspec.json.encode(seen | {"lights": self._lights.rows(seen["scale"] or 1)})

    def cells(self) -> bytes | None:
        """The luminance of each cell as CELLS_HEAD says; None before the first map."""
        with self._lock:
            readings = self._newest()
            return readings.cells() if readings else None

    def _newest(self) -> MapReadings | None:
        if self._map and (self._read is None or self._read[0] is not self._map):
            self._read = self._map, MapReadings(*self._map)
        return self._read[1] if self._read else None


def clipped_elements(elements: MapElements, clipped_pixels: int) -> np.ndarray:
    """Which of the elements (n,) hold light that the sensor clipped, (n,) bool: where it clipped any, those of the highest values.

    A clipped channel has the highest value that there is, and so has a cell that lies within clipped pixels; one that has few is missed.
    """
    if not clipped_pixels or not len(elements.radiance):
        return np.zeros(len(elements.radiance), bool)
    level = elements.radiance.max(axis=1)
    return (level >= TOP * level.max()) & (level > 0)


def histogram(luminance: np.ndarray, solid_angles: np.ndarray) -> dict[str, Any]:
    """Fractions of the solid angle and of the light in bins of 1 / BINS_PER_STOP stops, the first from 2^first on; darkness is in none.

    luminance, solid_angles: (n,). What is more than MAX_STOPS below the brightest is in the first bin.
    """
    lit = luminance > 0
    if not lit.any():
        return {"first": 0.0, "step": 1 / BINS_PER_STOP, "area": [], "light": []}
    bins = np.floor(np.log2(luminance[lit].astype(np.float64)) * BINS_PER_STOP).astype(np.int64)
    first = max(bins.min(), bins.max() - MAX_STOPS * BINS_PER_STOP)
    bins = np.maximum(bins - first, 0)
    area = np.bincount(bins, solid_angles[lit]) / solid_angles.sum()
    light = np.bincount(bins, solid_angles[lit].astype(np.float64) * luminance[lit])
    rounded = [np.round(each, 6).tolist() for each in (area, light / max(light.sum(), np.finfo(np.float32).tiny))]
    return {"first": float(first) / BINS_PER_STOP, "step": 1 / BINS_PER_STOP, "area": rounded[0], "light": rounded[1]}


def _colour(rgb: np.ndarray) -> dict[str, float | None]:
    temperature, duv = colour_temperature(rgb)
    return {"temperature_k": _number(temperature, 0), "duv": _number(duv, 4)}


def _number(value: np.ndarray, digits: int) -> float | None:
    """None for nan, which JSON does not have."""
    return None if np.isnan(value) else round(float(value), digits)
