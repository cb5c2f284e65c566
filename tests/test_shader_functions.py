"""Functions that exist in numpy and in GLSL under one name give the same values."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from vemlight.light.colour import luminance_from_rgb, srgb_from_linear
from vemlight.renderer.gl.constants import NORMAL_CODES
from vemlight.renderer.gl.programs import Programs, headless_context
from vemlight.renderer.luminaire.estimator import ggx_lobe
from vemlight.renderer.passes.gbuffer.normals import direction_from_octahedron, octahedron_from_code, octahedron_from_direction

VECTORS = {1: "float", 2: "vec2", 3: "vec3", 4: "vec4"}


@pytest.fixture(scope="module")
def evaluate() -> Iterator[Callable[..., np.ndarray]]:
    """Evaluates an expression of v with a shader include, for rows v (n, k); returns rows (n, m)."""
    context = headless_context()
    Programs(context)  # makes the includes known

    def run(include: str, expression: str, values: np.ndarray, results: int) -> np.ndarray:
        count, arguments = values.shape
        taken = ", ".join(f"given[{arguments} * i + {k}]" for k in range(arguments))
        program = context.compute_shader(
            f'#version 430\n#include "constants.glsl"\n#include "{include}"\nlayout(local_size_x = 1) in;\n'
            "layout(std430, binding = 1) readonly buffer Given { float given[]; };\n"
            "layout(std430, binding = 2) writeonly buffer Found { float found[]; };\n"
            "void main() {\n    uint i = gl_GlobalInvocationID.x;\n"
            f"    {VECTORS[arguments]} v = {VECTORS[arguments]}({taken});\n    {VECTORS[results]} result = {expression};\n"
            + "".join(f"    found[{results} * i + {k}] = {'result' if results == 1 else f'result[{k}]'};\n" for k in range(results))
            + "}\n"
        )
        given, found = context.buffer(values.astype(np.float32).tobytes()), context.buffer(reserve=4 * count * results)
        given.bind_to_storage_buffer(1)
        found.bind_to_storage_buffer(2)
        program.run(group_x=count)
        made = np.frombuffer(found.read(), np.float32).reshape(count, results)
        for resource in (program, given, found):
            resource.release()
        return made

    yield run
    context.release()


def directions(count: int) -> np.ndarray:
    """Unit vectors, the axes and what lies on the folds of the octahedron among them."""
    random = np.random.default_rng(1).normal(size=(count, 3))
    special = np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 0], [1, -1, 0], [-1, 0, -1], [0, 1, -1], [1e-4, 1e-4, -1]]])
    vectors = np.concatenate([special, random])
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_octahedron_from_direction(evaluate):
    given = directions(500).astype(np.float32).astype(np.float64)
    found = evaluate("normals.glsl", "octahedron_from_direction(v)", given, 2)
    np.testing.assert_allclose(found, octahedron_from_direction(given), atol=1e-6)


def test_direction_from_octahedron(evaluate):
    given = np.concatenate([np.random.default_rng(2).uniform(-1, 1, (500, 2)), [[0, 0], [1, 0], [0, -1], [1, 1], [-1, 1], [0.5, 0.5]]])
    found = evaluate("normals.glsl", "direction_from_octahedron(v)", given, 3)
    np.testing.assert_allclose(found, direction_from_octahedron(given.astype(np.float32).astype(np.float64)), atol=1e-6)


def test_directions_come_back_from_the_octahedron():
    given = directions(500)
    np.testing.assert_allclose(direction_from_octahedron(octahedron_from_direction(given)), given, atol=1e-12)


def test_codes_of_normals_hold_the_axes_exactly_and_come_back(evaluate):
    codes = np.arange(-NORMAL_CODES, NORMAL_CODES + 1, 97) / NORMAL_CODES
    given = np.stack([codes, codes[::-1]], axis=-1)
    stored = evaluate("normals.glsl", "code_from_octahedron(v)", given, 2)
    assert 0 <= stored.min() < stored.max() <= 1
    np.testing.assert_allclose(octahedron_from_code(stored), given, atol=1e-9)
    np.testing.assert_allclose(evaluate("normals.glsl", "octahedron_from_code(v)", stored, 2), given, atol=1e-6)
    whole = np.rint(evaluate("normals.glsl", "code_from_octahedron(v)", np.array([[0, 0], [1, -1]]), 2) * 65535) / 65535
    assert octahedron_from_code(whole).tolist() == [[0, 0], [1, -1]]


def test_srgb_from_linear(evaluate):
    given = np.concatenate([np.geomspace(1e-6, 1, 300), [0, 0.0031308, 0.0031309]])[:, None].repeat(3, axis=1)
    np.testing.assert_allclose(evaluate("colour.glsl", "srgb_from_linear(v)", given, 3), srgb_from_linear(given), atol=2e-6)


def test_luminance_from_rgb(evaluate):
    given = np.random.default_rng(3).uniform(0, 100, (100, 3))
    np.testing.assert_allclose(evaluate("colour.glsl", "luminance_from_rgb(v)", given, 1)[:, 0], luminance_from_rgb(given), rtol=1e-6)


def test_ggx_lobe(evaluate):
    rng = np.random.default_rng(4)
    alpha, light, view = rng.uniform(0.0025, 1, 300), rng.uniform(1e-4, 1, 300), rng.uniform(1e-4, 1, 300)
    sines = np.sqrt(1 - light**2) * np.sqrt(1 - view**2)
    between = light * view + sines * rng.uniform(-1, 1, 300)
    found = evaluate("brdf.glsl", "ggx_lobe(v.x, v.y, v.z, v.w)", np.stack([light, view, between, alpha], axis=-1), 2)
    expected = [ggx_lobe(*row) for row in zip(light, view, between, alpha, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-5)  # float32 loses digits in 1 - n^2 (1 - alpha^2) of narrow lobes
