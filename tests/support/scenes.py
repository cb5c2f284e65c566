"""The scenes beside the bundled one."""

from vemlight.renderer.scene.scene import BUNDLED_SCENE

SHAPES = BUNDLED_SCENE.with_name("shapes.toml")  # a pole, a ball, a box and a knot on a ground
