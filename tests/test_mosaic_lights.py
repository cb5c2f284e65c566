"""Lights sharper than a mosaic are said."""

import numpy as np
import pytest
from scipy.special import erf

from vemlight.capture.bracket_source import BracketMerger
from vemlight.capture.exposure_cycle import ExposureCycle
from vemlight.capture.exposure_merge import values_from_response
from vemlight.capture.frames import FrameMaker
from vemlight.capture.lens import Lens, write_lens
from vemlight.capture.live_brackets import LiveBrackets
from vemlight.capture.mosaic_lights import SHARP_SHARE, share_of_one_pixel
from vemlight.capture.response import Linear, code_from_radiance, write_response
from vemlight.settings import Capture

LENS = Lens(size=(120, 120), f=(37.0, 37.0), c=(59.5, 59.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=90.0)


def point(sigma: float, x: float, y: float) -> np.ndarray:
    """A point blurred by a Gaussian over pixels (120, 120), of power 1."""

    def along(centre: float) -> np.ndarray:
        edges = erf((np.arange(121) - 0.5 - centre) / sigma / np.sqrt(2))
        return np.diff(edges) / 2

    return np.outer(along(y), along(x))


SHARPNESS = [(0.3, 60.0, True), (0.5, 60.0, True), (0.5, 60.5, False), (0.8, 60.0, False), (1.5, 60.0, False)]


@pytest.mark.parametrize(("sigma", "x", "sharp"), SHARPNESS)
def test_the_share_of_one_pixel(sigma, x, sharp):
    light = 1 + 1e4 * point(sigma, x, x)
    assert (share_of_one_pixel(light, 60, 60) > SHARP_SHARE) == sharp


@pytest.mark.parametrize(("sigma", "mosaic", "said"), [(0.4, "RGGB", True), (1.2, "RGGB", False), (0.4, "mono", False)])
def test_a_sharp_light_on_a_mosaic_is_said_once(tmp_path, capsys, sigma, mosaic, said):
    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", Linear(bits=16, a=0.0, b=1.0))
    maker = FrameMaker(Capture(), tmp_path)
    codes = (10 + 60_000 * point(sigma, 70.0, 50.0)).astype(np.uint16)
    for _ in range(2):
        maker.frame_from_codes(str(tmp_path / "a.png"), codes, mosaic, 0.0)
    assert capsys.readouterr().err.count("is sharper than the mosaic") == said


@pytest.mark.parametrize("merge", ["live", "bracket"])
@pytest.mark.parametrize(("sigma", "mosaic", "said"), [(0.4, "RGGB", True), (1.2, "RGGB", False), (0.4, "mono", False)])
def test_a_sharp_light_is_said_of_merged_exposures(tmp_path, capsys, merge, sigma, mosaic, said):
    """By the frames of the shortest exposure, where no light was moved between pixels: the other frames may come first."""
    write_lens(tmp_path / "lens.toml", LENS)
    response = Linear(bits=12, a=64.0, b=4000.0)
    maker, values, exposures = FrameMaker(Capture(), tmp_path), values_from_response(response, 1), (0.064, 0.002, 0.0000625)
    noise = np.random.default_rng(4)
    light = 1 + 12_000 * point(sigma, 70.0, 50.0)
    codes = [np.clip(code_from_radiance(light * t, response) + noise.integers(-2, 3, light.shape), 0, 4095) for t in exposures]
    codes = [one.astype(np.uint16) for one in codes]
    if merge == "bracket":
        BracketMerger(maker).frame(merge, np.stack(codes), mosaic, values, exposures, 0.0)
    else:
        live = LiveBrackets(maker, merge, ExposureCycle(exposures), values, mosaic)
        for exposure in (1, 0, 2, 1, 0, 2):
            live.frame(codes[exposure], 0.0, exposure)
    assert capsys.readouterr().err.count(f"{merge}: a light at pixel 70, 50 is sharper than the mosaic") == said
