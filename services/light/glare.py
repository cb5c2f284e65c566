"""Daylight glare probability (DGP) of what an eye sees.

DGP = 5.87e-5 E_v + 9.18e-2 log10(1 + sum of L^2 omega / (E_v^1.87 P^2)) + 0.16 over the glare sources, of luminance L and solid angle omega
(Wienold and Christoffersen 2006, "Evaluation methods and development of a new glare prediction model for daylight environments", equation
3). P is the position index: Guth's above the line of sight (Luckiesh and Guth 1949; IES), that of CIE 232:2019 below it. Sources are found
as evalglare 3 finds them by default: what is above 2000 cd/m2, joined within 0.1 rad, and peaks above 50,000 cd/m2 as sources of their own.
"""

from typing import NamedTuple

import numpy as np

from vemlight.light.map_elements import MapElements

THRESHOLD_CD_M2, PEAK_CD_M2 = 2000.0, 50_000.0  # of a glare source, and of a peak in one
JOINED_RAD = 0.1  # parts of a source lie no farther from one another
MAX_POSITION_INDEX = 16.0
VALID_FROM_LX = 380.0  # of E_v; the formula was fitted to people who had more
# DGP up to which glare is imperceptible, perceptible, disturbing (Wienold 2009, table 1); above it is intolerable.
GRADES = ((0.35, "imperceptible"), (0.40, "perceptible"), (0.45, "disturbing"), (np.inf, "intolerable"))


class GlareSources(NamedTuple):
    """luminance: (n,) cd/m2. solid_angle: (n,) sr. direction: (n, 3), towards the centre of their light."""

    luminance: np.ndarray
    solid_angle: np.ndarray
    direction: np.ndarray


def glare_probability(illuminance_lx: float, sources: GlareSources, view: np.ndarray, up: np.ndarray) -> float:
    """DGP of an eye with vertical illuminance `illuminance_lx` that looks along the unit vector `view` (3,), `up` (3,) above it."""
    if illuminance_lx <= 0:
        return 0.0
    index = position_index(sources.direction, view, up)
    sum_glare = float((sources.luminance**2 * sources.solid_angle / index**2).sum())
    probability = 5.87e-5 * illuminance_lx + 9.18e-2 * np.log10(1 + sum_glare / illuminance_lx**1.87) + 0.16
    return float(min(probability, 1.0))


def grade_of(probability: float) -> str:
    """The word for a DGP, of GRADES."""
    return next(word for limit, word in GRADES if probability <= limit)


def position_index(direction: np.ndarray, view: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Position index P (...), 1 on the line of sight and at most 16, of unit vectors (..., 3)."""
    up = up - (up @ view) * view
    up = up / np.linalg.norm(up)
    ahead, above = direction @ view, direction @ up
    beside = direction @ np.cross(view, up)
    sigma = np.degrees(np.arctan2(np.hypot(above, beside), ahead))  # from the line of sight
    tau = np.degrees(np.arctan2(np.abs(beside), above))  # of its plane with the line of sight, from the vertical
    linear = (35.2 - 0.31889 * tau - 1.22 * np.exp(-2 * tau / 9)) * 1e-3
    square = (21 + 0.26667 * tau - 0.002963 * tau**2) * 1e-5
    guth = np.exp(linear * sigma + square * sigma**2)
    stretched = np.sqrt(1 + 0.3225 * np.cos(np.radians(tau)) ** 2)
    beta = np.degrees(np.arctan2(np.hypot(above, beside) * stretched, ahead))
    return np.minimum(np.where(above >= 0, guth, np.exp(6.49e-3 * beta + 21e-5 * beta**2)), MAX_POSITION_INDEX)


def glare_sources(elements: MapElements, luminance: np.ndarray, view: np.ndarray) -> GlareSources:
    """The sources before an eye that looks along `view` (3,). luminance: (n,) cd/m2 of the elements."""
    in_front = elements.directions @ view.astype(np.float32) > 0
    bright, peak = in_front & (luminance > THRESHOLD_CD_M2), in_front & (luminance >= PEAK_CD_M2)
    found = [_joined(elements, luminance, chosen) for chosen in (bright & ~peak, peak) if chosen.any()]
    if not found:
        return GlareSources(np.zeros(0), np.zeros(0), np.zeros((0, 3)))
    return GlareSources(*(np.concatenate(arrays) for arrays in zip(*found, strict=True)))


def _joined(elements: MapElements, luminance: np.ndarray, chosen: np.ndarray) -> GlareSources:
    """Those of the elements `chosen` (n,), joined where they lie within JOINED_RAD."""
    label, count = _labels(elements, chosen)
    solid_angle, level = elements.solid_angles[chosen].astype(np.float64), luminance[chosen].astype(np.float64)
    whole, light = np.bincount(label, solid_angle, count), np.bincount(label, solid_angle * level, count)
    centre = np.stack([np.bincount(label, solid_angle * level * axis, count) for axis in elements.directions[chosen].T], axis=-1)
    return GlareSources(light / whole, whole, centre / np.linalg.norm(centre, axis=1, keepdims=True))


def _labels(elements: MapElements, chosen: np.ndarray) -> tuple[np.ndarray, int]:
    """The number of its source for each chosen element, and how many there are.

    Neighbours are joined on the grid first, and then only the rims of what results are compared: a bright sky has 16,000 cells.
    """
    import cv2
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    cells, mask = elements.cells[chosen], np.zeros((elements.rows, elements.cols), np.uint8)
    mask.ravel()[cells] = 1
    count, patch = cv2.connectedComponents(mask, connectivity=8)
    inner = cv2.erode(mask, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    rim = mask > inner  # at the edges of the map, too: across them patches go on
    first = np.unique(cells, return_index=True)[1]
    on_rim = first[rim.ravel()[cells[first]]]
    near = KDTree(elements.directions[chosen][on_rim]).query_pairs(2 * np.sin(JOINED_RAD / 2), output_type="ndarray")
    of_rim = patch.ravel()[cells[on_rim]] - 1
    links = coo_matrix((np.ones(len(near)), (of_rim[near[:, 0]], of_rim[near[:, 1]])), (count - 1, count - 1))
    joined, source = connected_components(links, directed=False)
    return source[patch.ravel()[cells] - 1], joined
