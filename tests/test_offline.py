"""`vemlight lights` and `vemlight render` from options to settings."""

from pathlib import Path

import numpy as np
import pytest

from vemlight.commands.offline import open_frames, sampler_settings
from vemlight.commands.options import LightsOptions, RenderOptions
from vemlight.commands.rendering import renderer_settings
from vemlight.errors import UserError
from vemlight.light.images import write_exr
from vemlight.settings import MAX_PICTURE_SIDE, Renderer

HERE = Path()


@pytest.mark.parametrize(("coverage", "rows"), [("hemisphere", 90), ("sphere", 180)])
def test_rows_of_the_map_are_a_degree_high_whatever_it_covers(tmp_path, coverage, rows):
    write_exr(tmp_path / "sky.exr", np.ones((8, 16, 3), np.float32))
    frames = open_frames(LightsOptions(source=tmp_path / "sky.exr", out=HERE, coverage=coverage))
    assert frames.frame(0).radiance.shape == (rows, 360, 3)


@pytest.mark.parametrize(("asked", "frames", "used"), [(None, 1, "none"), (None, 2, "auto"), ("adaptive", 1, "adaptive")])
def test_a_single_map_is_not_filtered_unless_asked(asked, frames, used):
    assert sampler_settings(LightsOptions(source=HERE, out=HERE, filter=asked), frames).filter == used


def test_options_become_settings_of_the_sampler():
    options = LightsOptions(source=HERE, out=HERE, count=5, method="standard", deflicker=True)
    found = sampler_settings(options, 2, clusters=3, error_percent=None)
    assert (found.count, found.method, found.deflicker, found.clusters, found.error_percent) == (5, "standard", True, 3, None)


def test_options_become_settings_of_the_renderer():
    options = RenderOptions(source=HERE, size=(32, 24), exposure=1.5, tone="exponential", background="map", shadow_map=64)
    assert renderer_settings(options) == Renderer(
        width=32, height=24, exposure=1.5, tone="exponential", background="map", shadow_map=64, light_regions=0
    )
    assert renderer_settings(RenderOptions(source=HERE, coverage="sphere")).light_regions is None  # the renderer's own choice


@pytest.mark.parametrize("size", [(0, 24), (32, 0), (MAX_PICTURE_SIDE + 1, 24)])
def test_a_picture_of_no_size_or_beyond_the_limit_is_refused(size):
    assert renderer_settings(RenderOptions(source=HERE, size=(MAX_PICTURE_SIDE, 1))).width == MAX_PICTURE_SIDE == 8192
    with pytest.raises(UserError, match=f"--size {size[0]}x{size[1]}: a side has 1 to 8192 pixels"):
        renderer_settings(RenderOptions(source=HERE, size=size))
