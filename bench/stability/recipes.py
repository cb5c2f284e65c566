"""Maps from recipes: lat-long images of (HEIGHT, WIDTH, 3) float32 that are the same numbers on every machine.

Row 0 is the zenith, the centre column +X, a quarter from the left +Y, as everywhere. Sources have their extent, four samples a pixel
each way where their edges are; the horizon of each map is its middle row, and below is a dark ground.
"""

from collections.abc import Callable

import numpy as np

from vemlight.light.sphere import direction_from_angles, latlong_directions

HEIGHT, WIDTH = 512, 1024
FINER = 4  # samples of a pixel each way: a source of half a degree covers a pixel and a half, and keeps its power to 1 %
GROUND = 0.1  # radiance below the horizon, over the mean of the sky


def _smooth_noise(seed: int, octaves: int, roughness: float) -> np.ndarray:
    """(HEIGHT, WIDTH) noise of mean 0 and standard deviation 1, periodic in azimuth: octaves of random values on grids that double."""
    generator, total = np.random.default_rng(seed), np.zeros((HEIGHT, WIDTH))
    for octave in range(octaves):
        rows, cols = 4 * 2**octave, 8 * 2**octave
        values = generator.standard_normal((rows + 1, cols))
        y, x = np.meshgrid(np.linspace(0, rows, HEIGHT), np.arange(WIDTH) * cols / WIDTH, indexing="ij")
        y0, x0 = np.minimum(y.astype(int), rows - 1), x.astype(int) % cols
        v, u = y - y0, x - x.astype(int)
        u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
        top = (1 - u) * values[y0, x0] + u * values[y0, (x0 + 1) % cols]
        low = (1 - u) * values[y0 + 1, x0] + u * values[y0 + 1, (x0 + 1) % cols]
        total += roughness**octave * ((1 - v) * top + v * low)
    return (total - total.mean()) / total.std()


def _disc(theta_deg: float, phi_deg: float, diameter_deg: float) -> np.ndarray:
    """The fraction of each pixel (HEIGHT, WIDTH) that a round source covers."""
    centre, radius = direction_from_angles(np.radians(theta_deg), np.radians(phi_deg)), np.radians(diameter_deg / 2)
    covered = np.zeros((HEIGHT, WIDTH))
    near = np.nonzero(latlong_directions(HEIGHT, WIDTH) @ centre > np.cos(radius + np.pi / HEIGHT))  # a pixel's diagonal beyond, and more
    part = (np.arange(FINER) + 0.5) / FINER
    rows, columns = near[0][:, None, None] + part[:, None], near[1][:, None, None] + part
    fine = direction_from_angles(np.pi * rows / HEIGHT, np.pi - 2 * np.pi * columns / WIDTH)
    covered[near] = (fine @ centre > np.cos(radius)).mean(axis=(1, 2))
    return covered


def _pane(theta_deg: tuple[float, float], phi_deg: tuple[float, float]) -> np.ndarray:
    """The fraction of each pixel that lies between these polar angles and azimuths."""
    directions = latlong_directions(HEIGHT, WIDTH)
    theta = np.degrees(np.arccos(np.clip(directions[..., 2], -1, 1)))
    phi = np.degrees(np.arctan2(directions[..., 1], directions[..., 0])) % 360
    step = 180 / HEIGHT
    across = np.clip((theta - theta_deg[0]) / step + 0.5, 0, 1) * np.clip((theta_deg[1] - theta) / step + 0.5, 0, 1)
    along = np.clip((phi - phi_deg[0]) / step + 0.5, 0, 1) * np.clip((phi_deg[1] - phi) / step + 0.5, 0, 1)
    return across * along


def _over_ground(sky: np.ndarray) -> np.ndarray:
    image = np.where((np.arange(HEIGHT) < HEIGHT // 2)[:, None, None], sky, GROUND * sky[: HEIGHT // 2].mean())
    return image.astype(np.float32)


def clear() -> np.ndarray:
    """A blue sky, brighter towards the horizon, with a sun of half a degree that has about three quarters of the light."""
    height = np.clip(latlong_directions(HEIGHT, WIDTH)[..., 2:], 0, 1)
    sky = [0.25, 0.45, 0.9] * (1.0 + 1.5 * (1 - height) ** 4)
    return _over_ground(sky + _disc(42.0, 70.0, 0.53)[..., None] * [1.6e5, 1.5e5, 1.35e5])


def overcast() -> np.ndarray:
    """A sky three times as bright at the zenith as at the horizon (Moon and Spencer 1942), with clouds of all sizes."""
    height = np.clip(latlong_directions(HEIGHT, WIDTH)[..., 2:], 0, 1)
    clouds = np.exp(0.35 * _smooth_noise(1, 6, 0.55))[..., None]
    return _over_ground((1 + 2 * height) / 3 * clouds * [0.9, 0.95, 1.0])


def room() -> np.ndarray:
    """Dim walls, two windows of which one sees a bright sky, and a warm lamp of six degrees."""
    walls = 0.05 * np.exp(0.2 * _smooth_noise(2, 5, 0.6))[..., None] * [1.0, 0.92, 0.8]
    image = walls + _pane((50, 80), (20, 58))[..., None] * [6.0, 7.0, 8.5] + _pane((48, 78), (190, 205))[..., None] * [2.5, 2.8, 3.2]
    return _over_ground(image + _disc(25.0, 300.0, 6.0)[..., None] * [40.0, 28.0, 14.0])


def night() -> np.ndarray:
    """A dark sky and eight lamps of half a degree to two degrees, of several colours, most of them low."""
    image = np.full((HEIGHT, WIDTH, 3), 0.002) * [0.6, 0.7, 1.0]
    generator = np.random.default_rng(3)
    colours = np.array([[1.0, 0.6, 0.25], [0.8, 0.9, 1.0], [1.0, 0.75, 0.5]])
    for k in range(8):
        theta, phi = 90 - 60 * generator.random() ** 1.5 - 4, 360 * (k + 0.8 * generator.random()) / 8
        size = 0.5 + 1.5 * generator.random()
        image = image + _disc(theta, phi, size)[..., None] * colours[k % 3] * generator.uniform(50, 400)
    return _over_ground(image)


RECIPES: dict[str, Callable[[], np.ndarray]] = {"clear sky": clear, "overcast": overcast, "room": room, "night": night}
