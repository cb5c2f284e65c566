from pathlib import Path

import numpy as np
import pytest

from tests.support.rendering import SceneRenderer
from vemlight.errors import UserError
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import quaternion_xyz
from vemlight.renderer.luminaire.bases import BasisKind
from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.luminaire.luminaire_file import write_luminaire
from vemlight.renderer.luminaire.reference import irradiance
from vemlight.renderer.luminaire.shadow_views import cell_views, median, median_pixel
from vemlight.renderer.passes.luminaires.depth_range import depth_range
from vemlight.renderer.passes.luminaires.luminaire_atlas import LuminaireAtlas
from vemlight.renderer.scene.luminaire_table import world_from_lamp
from vemlight.renderer.scene.scene import load_scene
from vemlight.runtime.poses import Pose
from vemlight.settings import Renderer as Settings

DARK = LightSet.of(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))
SIZE = 48
FROM_ABOVE = "[camera]\nfrom = [0.0, 0.0, 40.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 4.0\n"  # 2.8 m of the ground
GROUND = '[[mesh]]\nshape = "plane"\nscale = 4.0\nmaterial = {diffuse = [1.0, 1.0, 1.0]}\n'
BALL = '[[mesh]]\nshape = "sphere"\nscale = 0.2\nat = [0.1, 0.1, 0.4]\nmaterial = {diffuse = [0.4, 0.3, 0.3], specular = [0.2, 0.2, 0.2]}\n'
LAMP = '[[luminaire]]\nfile = "lamp.exr"\nat = [0.0, 0.0, 1.5]\nrotate = [180.0, 0.0, 0.0]\nmethod = "sampled"\n'


def a_field(kind: BasisKind = "bell", distance: float = 0.3, window: float = 0.2) -> LightField:
    rng = np.random.default_rng(1)
    y, x = np.meshgrid(np.linspace(-1, 1, 16), np.linspace(-1, 1, 16), indexing="ij")
    images = np.empty((3, 4, 16, 16, 3))
    for j, i in np.ndindex(3, 4):
        lobe = np.exp(-3 * ((x - (i - 1.5) / 5) ** 2 + (y - (j - 1) / 5) ** 2)) * np.exp(0.4 * rng.normal(size=(16, 16)))
        images[j, i] = lobe[..., None] * [1.0, 0.8, 0.6]
    return LightField(images.astype(np.float32), kind, 0.03, (-0.045, -0.03), distance, (-window, -window, window, window), "radiometric",
                      "lobes")


def scene_with(folder: Path, text: str, field: LightField | None = None):
    write_luminaire(folder / "lamp.exr", field or a_field())
    (folder / "scene.toml").write_text(text)
    return load_scene(folder / "scene.toml")


def picture(scene, lights: LightSet = DARK, samples: int = 1, move=None) -> np.ndarray:
    renderer = SceneRenderer(scene, Settings(width=SIZE, height=SIZE, shadow_map=64), samples)
    try:
        if move:
            renderer.picture(lights)
            number, at, rotate, power = move
            lamp = scene.objects[len(scene.objects) - len(scene.luminaires) + number].name
            renderer.place(0.0, [Pose(name=lamp, position=at, rotation=quaternion_xyz(rotate), power=power)])
        return renderer.picture(lights).copy()
    finally:
        renderer.release()


def ground_points() -> np.ndarray:
    """World positions of the pixels of FROM_ABOVE on the ground, (SIZE * SIZE, 3): +X right, +Y up."""
    step = 2 * 40 * np.tan(np.radians(2)) / SIZE
    x = (np.arange(SIZE) + 0.5 - SIZE / 2) * step
    return np.stack([*np.meshgrid(x, -x), np.zeros((SIZE, SIZE))], axis=-1).reshape(-1, 3)


@pytest.mark.parametrize("kind", ["bell", "b-spline"])
def test_a_white_ground_reflects_the_exact_irradiance_over_pi(tmp_path, kind):
    field = a_field(kind)
    image = picture(scene_with(tmp_path, FROM_ABOVE + GROUND + LAMP + "samples = 3000\ninterleave = 1\n", field))[..., :3].reshape(-1, 3)
    world_from_local = world_from_lamp((0.0, 0.0, 1.5), (180.0, 0.0, 0.0))
    some = np.random.default_rng(2).choice(SIZE * SIZE, 60, replace=False)
    local = (ground_points()[some] - world_from_local[:3, 3]) @ world_from_local[:3, :3]
    truth = np.array([irradiance(field, p, np.array([0.0, 0.0, -1.0])) for p in local]) / np.pi
    assert np.abs(image[some] - truth).max() < 0.01 * truth.max()  # 3,000 Halton points


def test_the_gpu_draws_what_the_cpu_draws(tmp_path):
    """The same samples in float32 and float64, with a pixel 10^5 times the mean in a table that only float64 holds."""
    field = a_field()
    field.images[1, 2, 8, 9] = 1e5 * field.images.mean()
    lamp = LAMP + "samples = 40\ninterleave = 4\n"
    scene = scene_with(tmp_path, FROM_ABOVE + GROUND + lamp + 'shadows = "none"\n', field)
    gpu = picture(scene)[..., :3]
    cpu = picture(scene_with(tmp_path, FROM_ABOVE + GROUND + lamp + 'shadows = "traced"\n', field))[..., :3]
    assert cpu.max() > 0
    close = np.abs(gpu - cpu) <= 5e-3 * cpu + 1e-5 * cpu.max()
    # a sample within 10^-7 of a pixel's edge may fall on either side of it
    assert np.mean(close) > 0.999
    assert gpu.sum() == pytest.approx(cpu.sum(), rel=1e-3)


@pytest.mark.parametrize("material", ["{base_color = [0.9, 0.6, 0.3], metallic = 1.0, roughness = 0.35}",
                                      "{diffuse = [0.3, 0.2, 0.1], specular = [0.5, 0.4, 0.3], exponent = 30.0}"])
def test_the_gpu_reflects_as_the_cpu_does(tmp_path, material):
    """A glossy ball in the beam, so that both lobes are seen from all sides."""
    ball = f'[[mesh]]\nshape = "sphere"\nscale = 0.5\nat = [0.1, 0.1, 0.4]\nmaterial = {material}\n'
    gpu, cpu = (picture(scene_with(tmp_path, FROM_ABOVE + ball + LAMP + f'samples = 40\nshadows = "{way}"\n'))[..., :3]
                for way in ("none", "traced"))
    lit = cpu.max(axis=-1) > 0.001 * cpu.max()
    assert lit.sum() > 40
    # a sample within 10^-7 of a pixel's edge may fall on either side of it
    assert np.mean((np.abs(gpu - cpu)[lit] < 1e-4 * cpu[lit].max(axis=-1, keepdims=True)).all(axis=-1)) > 0.97


def test_black_one_lit_pixel_and_negative_pixels_on_the_gpu(tmp_path):
    black = a_field()._replace(images=np.zeros((3, 4, 16, 16, 3), np.float32))
    text = FROM_ABOVE + GROUND + LAMP + "samples = 2000\ninterleave = 1\n"
    assert not picture(scene_with(tmp_path, text, black))[..., :3].any()
    black.images[1, 2, 8, 9] = [1, 2, 4]
    field = a_field()
    field.images[:, :, ::3] *= -0.3
    points = ground_points()[SIZE * SIZE // 2 - SIZE :: 7]
    world_from_local = world_from_lamp((0.0, 0.0, 1.5), (180.0, 0.0, 0.0))
    local = (points - world_from_local[:3, 3]) @ world_from_local[:3, :3]
    for case, off in ((black, 0.01), (field, 0.03)):  # 2,000 Halton points; rows of both signs jump within a box
        image = picture(scene_with(tmp_path, text, case))[..., :3].reshape(-1, 3)[SIZE * SIZE // 2 - SIZE :: 7]
        truth = np.array([irradiance(case, p, np.array([0.0, 0.0, -1.0])) for p in local]) / np.pi
        assert truth.max() > 0
        assert np.abs(image - np.maximum(truth, 0)).max() < off * truth.max()


def test_maps_cast_the_shadows_that_rays_cast(tmp_path):
    pictures = {}
    for shadows in ("maps", "traced", "none"):
        text = FROM_ABOVE + GROUND + BALL + LAMP + f'samples = 150\nshadow_map = 256\nshadows = "{shadows}"\n'
        pictures[shadows] = picture(scene_with(tmp_path, text))[..., :3]

    def off(a):
        return np.sqrt(np.mean((pictures[a] - pictures["traced"]) ** 2)) / pictures["traced"].mean()
    assert off("maps") < 0.25 * off("none")
    assert pictures["maps"].sum() == pytest.approx(pictures["traced"].sum(), rel=0.02)


def test_the_approximation_is_near_the_samples_for_a_narrow_lamp(tmp_path):
    field = a_field("bell", 1.5, 0.15)
    text = FROM_ABOVE + GROUND + BALL + LAMP.replace('"sampled"', '"METHOD"') + "samples = 600\n"
    exact, spots = (picture(scene_with(tmp_path, text.replace("METHOD", m), field))[..., :3] for m in ("sampled", "shift-invariant"))
    assert np.sqrt(np.mean((spots - exact) ** 2)) < 0.06 * np.sqrt(np.mean(exact**2))
    assert spots.sum() == pytest.approx(exact.sum(), rel=0.02)


def test_auto_chooses_by_the_errors(tmp_path):
    text = FROM_ABOVE + GROUND + LAMP.replace("sampled", "auto")
    assert not scene_with(tmp_path, text + "samples = 3000\n").luminaires[0].drawn.shift_invariant
    assert scene_with(tmp_path, text, a_field("bell", 1.5, 0.05)).luminaires[0].drawn.shift_invariant
    traced = scene_with(tmp_path, text + 'shadows = "traced"\n', a_field("bell", 1.5, 0.05)).luminaires[0].drawn
    assert not traced.shift_invariant
    assert 64 <= traced.samples <= 512


def test_luminaires_add_up_with_each_other_and_with_the_lights(tmp_path):
    sky = LightSet.of(np.arange(1), np.array([[0.0, 0.6, 0.8]]), np.ones((1, 3)))
    other = LAMP.replace("at = [0.0, 0.0, 1.5]", "at = [0.5, 0.2, 1.0]")
    one, two, both = (picture(scene_with(tmp_path, FROM_ABOVE + GROUND + BALL + lamps)) for lamps in (LAMP, other, LAMP + other))
    lit = picture(scene_with(tmp_path, FROM_ABOVE + GROUND + BALL), sky)
    together = picture(scene_with(tmp_path, FROM_ABOVE + GROUND + BALL + LAMP + other), sky)
    assert np.allclose(both[..., :3], one[..., :3] + two[..., :3], rtol=1e-4, atol=1e-6)
    assert np.allclose(together[..., :3], both[..., :3] + lit[..., :3], rtol=1e-4, atol=1e-6)
    assert np.array_equal(together[..., 3], lit[..., 3])


def test_a_moved_and_dimmed_lamp_is_as_if_it_had_always_been_there(tmp_path):
    scene = scene_with(tmp_path, FROM_ABOVE + GROUND + BALL + LAMP)
    there = scene_with(tmp_path, FROM_ABOVE + GROUND + BALL + LAMP.replace("[0.0, 0.0, 1.5]", "[0.3, 0.1, 1.2]") + "power = 0.5\n")
    assert np.array_equal(picture(scene, move=(0, (0.3, 0.1, 1.2), (180.0, 0.0, 0.0), 0.5)), picture(there))


def pose(name: str, at: tuple[float, float, float], power: float | None = None) -> Pose:
    return Pose(name=name, position=at, rotation=quaternion_xyz((180.0, 0.0, 0.0)), power=power)


def test_poses_of_several_lamps_make_the_picture_of_lamps_that_stand_there(tmp_path):
    def lamp(name: str, at: str, power: float = 1.0) -> str:
        return LAMP.replace("[0.0, 0.0, 1.5]", at) + f'name = "{name}"\npower = {power}\nshadow_map = 96\n'
    there = scene_with(tmp_path, FROM_ABOVE + GROUND + BALL + lamp("a", "[0.4, 0.3, 1.3]") + lamp("b", "[-0.3, 0.2, 1.6]", 0.5))
    wanted = picture(there)
    scene = scene_with(tmp_path, FROM_ABOVE + GROUND + BALL + lamp("a", "[0.0, 0.0, 1.5]") + lamp("b", "[0.2, 0.0, 1.5]"))
    renderer = SceneRenderer(scene, Settings(width=SIZE, height=SIZE, shadow_map=64))
    rest = renderer.picture(DARK).copy()
    renderer.place(0.0, [pose("a", (0.4, 0.3, 1.3)), pose("b", (-0.3, 0.2, 1.6), 0.5)])
    moved = renderer.picture(DARK).copy()
    renderer.release()
    assert np.abs(moved - wanted).max() < 1e-5 * wanted.max()  # a turn is a quaternion in one and three angles in the other
    assert np.abs(rest - wanted).max() > 0.1 * wanted.max()


def test_only_the_maps_of_a_lamp_that_moved_are_drawn(tmp_path, monkeypatch):
    text = FROM_ABOVE + GROUND + BALL + LAMP + 'name = "a"\n' + LAMP.replace("[0.0,", "[0.3,", 1) + 'name = "b"\n'
    renderer = SceneRenderer(scene_with(tmp_path, text), Settings(width=SIZE, height=SIZE, shadow_map=64))
    drawn, draw = [], LuminaireAtlas.draw

    def counted(atlas: LuminaireAtlas, *arguments) -> None:
        drawn.append(atlas)
        draw(atlas, *arguments)
    monkeypatch.setattr(LuminaireAtlas, "draw", counted)

    def maps_of(*poses: Pose) -> int:
        drawn.clear()
        renderer.place(0.0, poses)
        renderer.picture(DARK)
        return len(set(drawn))
    there, ball = pose("a", (0.1, 0.0, 1.5)), Pose(name="sphere", position=(0.2, 0.1, 0.4))
    assert maps_of() == 2
    assert maps_of() == 0
    assert maps_of(there) == 1
    assert maps_of(there) == 0
    assert maps_of(pose("a", there.position, 3.0)) == 0
    assert maps_of(there, ball) == 2
    assert maps_of(ball) == 1
    renderer.release()


def test_behind_the_lamp_and_with_no_power_it_is_dark(tmp_path):
    for change in (LAMP.replace("[180.0, 0.0, 0.0]", "[0.0, 0.0, 0.0]"), LAMP + "power = 0.0\n"):
        image = picture(scene_with(tmp_path, FROM_ABOVE + GROUND + change))
        assert not image[..., :3].any()
        assert image[..., 3].min() == 1


def test_a_far_field_lights_by_the_inverse_square(tmp_path):
    numbers = [1, 1000, 1.0, 3, 1, 1, 2, 0.1, 0.1, 0.0, 1.0, 1.0, 10, 0, 90, 180, 0, 100, 100, 100]
    (tmp_path / "even.ies").write_text("TILT=NONE\n" + " ".join(str(n) for n in numbers))
    lamp = '[[luminaire]]\nfile = "even.ies"\nat = [0.0, 0.0, 1.5]\n'
    image = picture(scene_with(tmp_path, FROM_ABOVE + GROUND + lamp))[..., :3].reshape(-1, 3)
    r = np.linalg.norm(ground_points() - [0, 0, 1.5], axis=1)
    assert image == pytest.approx(np.repeat((100 * 1.5 / r**3 / np.pi)[:, None], 3, axis=1), rel=2e-3)
    shadowed = picture(scene_with(tmp_path, FROM_ABOVE + GROUND + BALL + lamp))[..., :3].reshape(-1, 3)
    # the ball hangs at 0.4 m below the lamp's 1.5 m: its shadow is centred at 0.1 x 1.5 / 1.1 and 0.2 x 1.5 / 1.1 wide, under the ball
    # itself but for a rim on the far side
    rim = np.hypot(*(ground_points()[:, :2] - 0.1 * 1.5 / 1.1).T) < 0.2
    rim &= np.hypot(*(ground_points()[:, :2] - 0.1).T) > 0.24
    assert np.all(shadowed[rim] == 0)


@pytest.mark.parametrize(("text", "said"), [
    ('[[luminaire]]\nfile = "none.exr"\n', "no such file"),
    ('[[luminaire]]\nfile = "lamp.exr"\nsamples = 0\n', "samples"),
    ('[[luminaire]]\nfile = "lamp.exr"\nat = [nan, 0.0, 0.0]\n', "finite"),
    ('[[luminaire]]\nfile = "lamp.exr"\ncolour = 1\n', "colour"),
    ('[[luminaire]]\nfile = "lamp.exr"\nshadows = "soft"\n', "shadows"),
])
def test_a_bad_table_is_refused(tmp_path, text, said):
    with pytest.raises(UserError, match=said) as caught:
        scene_with(tmp_path, FROM_ABOVE + GROUND + text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("rows", "cols", "kind", "count"), [(7, 9, "bell", 80), (5, 5, "b-spline", 49), (9, 11, "b-spline", 143)])
def test_there_are_as_many_maps_as_2015_counts(rows, cols, kind, count):
    field = a_field(kind)._replace(images=np.ones((rows, cols, 4, 4, 3), np.float32))
    for reference in ("sampling", "measurement"):
        views = cell_views(field, 0.005, 5.0, reference)
        assert len(views.views) == count
        assert np.all(views.views["low"] < views.views["high"])


def test_the_reference_on_the_measurement_plane_is_where_the_light_is():
    field = a_field()._replace(images=np.zeros((3, 4, 16, 16, 3), np.float32))
    field.images[:, :, 5, 12] = 1
    s = np.array([-0.2 + 12.5 * 0.025, -0.2 + 5.5 * 0.025])
    assert median_pixel(field.images[0, 0]) == pytest.approx((12.5, 5.5, 1), abs=1e-9)
    assert cell_views(field, 0.005, 5.0, "measurement").views["origin"] == pytest.approx(np.tile([*s, 0.3], (20, 1)), abs=1e-6)
    assert median(np.array([1.0, 2.0, 1.0])) == 1.5
    assert median(np.array([0.0, 1.0, 0.0, 1.0, 0.0])) in (2, 3)
    field.images[:] = 0
    assert np.all(cell_views(field, 0.005, 5.0, "measurement").views["origin"][:, :2] == 0)


def test_maps_begin_at_a_thousandth_of_how_far_things_reach_and_hold_a_ground_of_kilometres():
    things = np.array([[[0.0, 0.0, 2.0 + k]] * 8 for k in range(4)])
    ground = np.array([[[6000.0, 8000.0, 0.0]] * 8])
    assert depth_range(np.zeros(3), things) == pytest.approx((2e-3, 5.05))
    assert depth_range(np.zeros(3), np.concatenate([things, ground])) == pytest.approx((3e-3, 10_100.0))


def test_a_lamp_s_shadow_stays_where_the_ground_is_of_kilometres(tmp_path):
    plate = '[[mesh]]\nshape = "plane"\nscale = 0.25\nat = [0.0, 0.0, 0.3]\nmaterial = {diffuse = [0.0, 0.0, 0.0]}\n'
    wide = '[[mesh]]\nshape = "plane"\nscale = 8000.0\nat = [0.0, 0.0, -1.0]\nmaterial = {diffuse = [0.0, 0.0, 0.0]}\n'
    near, far = (picture(scene_with(tmp_path, FROM_ABOVE + GROUND + more + plate + LAMP + 'shadows = "maps"\n')) for more in ("", wide))
    assert far[..., :3] == pytest.approx(near[..., :3], abs=0.01 * float(near.max()))


def test_shadow_views_reach_over_87_degrees():
    field = a_field(distance=0.01, window=1.0)
    views = cell_views(field, 0.005, 5.0)
    assert np.degrees(np.arctan(views.views["high"])) == pytest.approx(np.full((20, 2), 87.1), abs=0.1)
    assert np.array_equal(views.views["low"], -views.views["high"])


def test_a_luminaire_of_too_many_cells_is_refused(tmp_path):
    field = a_field()._replace(images=np.ones((1, 1024, 1, 1, 3), np.float32))  # 2 x 1025 cells
    with pytest.raises(UserError, match="2050 cells are more than 2048"):
        picture(scene_with(tmp_path, FROM_ABOVE + GROUND + LAMP, field))


def test_views_stand_in_the_middle_of_their_cells():
    origins = cell_views(a_field(), 0.005, 5.0).views["origin"].reshape(4, 5, 3)
    assert origins[0, 0] == pytest.approx([-0.06, -0.045, 0], abs=1e-7)  # half a spacing before the first function
    assert origins[-1, -1] == pytest.approx([0.06, 0.045, 0], abs=1e-7)


@pytest.mark.parametrize(("height", "shadowed"), [(0.025, True), (0.015, False)])
def test_a_map_sees_what_stands_half_a_texel_above_a_surface(tmp_path, height, shadowed):
    """A texel of 64 over tangents of 0.8 is 0.025 of the depth: 1.9 cm at 1.5 m for half of one, which a surface's own bends may take."""
    plate = f'[[mesh]]\nshape = "plane"\nscale = 0.25\nat = [0.0, 0.0, {height}]\nmaterial = {{diffuse = [0.0, 0.0, 0.0]}}\n'
    maps, none = (picture(scene_with(tmp_path, FROM_ABOVE + GROUND + plate + LAMP + f'samples = 100\nshadow_map = 64\nshadows = "{way}"\n'))
                  for way in ("maps", "none"))
    assert (maps[..., :3].sum() < 0.98 * none[..., :3].sum()) == shadowed
