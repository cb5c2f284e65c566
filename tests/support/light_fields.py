"""Light fields of tests."""

import numpy as np

from vemlight.renderer.luminaire.bases import BasisKind
from vemlight.renderer.luminaire.lightfield import LightField


def lobed_field(kind: BasisKind = "bell", contrast: float = 1.0, seed: int = 1) -> LightField:
    """A lamp-like field: a lobe that moves over the image with the basis function, tinted, with log-normal grain of `contrast`."""
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(np.linspace(-1, 1, 24), np.linspace(-1, 1, 24), indexing="ij")
    images = np.empty((5, 5, 24, 24, 3))
    for j, i in np.ndindex(5, 5):
        lobe = np.exp(-3 * ((x - (i - 2) / 5) ** 2 + (y - (j - 2) / 5) ** 2)) * np.exp(contrast * rng.normal(size=(24, 24)))
        images[j, i] = lobe[..., None] * [1.0, 0.8 + 0.2 * i / 5, 0.6]
    return LightField(images.astype(np.float32), kind, 0.05, (-0.1, -0.1), 0.4, (-0.5, -0.5, 0.5, 0.5), "radiometric", "lobes")
