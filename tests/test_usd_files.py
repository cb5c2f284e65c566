"""USD scenes, read by usd-core in a process of its own."""
# pyright: reportAttributeAccessIssue=false

import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from vemlight.errors import UserError
from vemlight.renderer.scene import usd_files
from vemlight.renderer.scene.materials import Ggx
from vemlight.renderer.scene.mesh_files import MeshFile, read_meshes
from vemlight.renderer.scene.scene import load_scene
from vemlight.renderer.scene.scene_pose import scene_pose

pytest.importorskip("pxr", reason="usd-core is not installed")

SQUARE = """
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
        uniform token subdivisionScheme = "none"
"""


def usda(body: str, metadata: str = 'metersPerUnit = 1\n    upAxis = "Y"') -> str:
    return f'#usda 1.0\n(\n    {metadata}\n)\n{body}\n'


def mesh(name: str, more: str = "", square: str = SQUARE) -> str:
    return f'def Mesh "{name}" {{{square}{more}\n}}\n'


def read(folder: Path, text: str, name: str = "scene.usda") -> MeshFile:
    (folder / name).write_text(text)
    return read_meshes(folder / name, "scene.toml")


def refused(folder: Path, text: str) -> str:
    with pytest.raises(UserError) as caught:
        read(folder, text)
    line = str(caught.value)
    assert "\n" not in line
    return line


def test_up_axis_unit_and_transforms_of_parents_are_applied(tmp_path):
    body = 'def Xform "up" {\n    double3 xformOp:translate = (0, 0, 300)\n    uniform token[] xformOpOrder = ["xformOp:translate"]\n'
    part = read(tmp_path, usda(body + mesh("square") + "}", 'metersPerUnit = 0.01\n    upAxis = "Z"')).parts[0]
    # Z is up in the file, and Y in what is made of it.
    np.testing.assert_allclose(part.geometry.positions.mean(axis=0), [0, 3, 0], atol=1e-6)
    np.testing.assert_allclose(np.ptp(part.geometry.positions, axis=0), [0.02, 0, 0.02], atol=1e-6)
    np.testing.assert_allclose(part.geometry.normals, np.tile([0, 1, 0], (4, 1)), atol=1e-6)
    (tmp_path / "scene.toml").write_text('[camera]\nfrom = [3.0, 0.0, 3.0]\nat = [0.0, 0.0, 3.0]\n[[mesh]]\nfile = "scene.usda"\n')
    scene = load_scene(tmp_path / "scene.toml")
    np.testing.assert_allclose(scene.meshes[0].geometry.positions.mean(axis=0), [0, 0, 3], atol=1e-6)


def test_an_axis_that_cannot_be_up_is_refused(tmp_path):
    with pytest.raises(UserError, match="upAxis = X, and Y and Z are read"):
        read(tmp_path, usda(mesh("square"), 'metersPerUnit = 1\n    upAxis = "X"'))


def test_left_handed_faces_holes_and_concave_ones(tmp_path):
    left = 'uniform token orientation = "leftHanded"'
    np.testing.assert_allclose(read(tmp_path, usda(mesh("left", left))).parts[0].geometry.normals[0], [0, 0, -1])
    two = SQUARE.replace("[4]", "[4, 4]").replace("[0, 1, 2, 3]", "[0, 1, 2, 3, 0, 1, 5, 4]")
    two = two.replace("(-1, 1, 0)]", "(-1, 1, 0), (-1, -1, 5), (1, -1, 5)]")
    whole = read(tmp_path, usda(mesh("two", square=two))).parts[0].geometry
    holed = read(tmp_path, usda(mesh("two", "int[] holeIndices = [1]", two))).parts[0].geometry
    assert (len(whole.triangles), len(holed.triangles)) == (4, 2)
    assert holed.positions[:, 2].max() == 0
    chevron = SQUARE.replace("(1, 1, 0)", "(-0.5, -0.5, 0)")
    g = read(tmp_path, usda(mesh("chevron", square=chevron))).parts[0].geometry
    corners = g.positions[g.triangles].astype(float)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(1.0)  # two of 2 x 0.5 / 2


def surface(inputs: str, name: str = "paint", more: str = "") -> str:
    return f'''def Material "{name}" {{
    token outputs:surface.connect = </{name}/surface.outputs:surface>
    def Shader "surface" {{
        uniform token info:id = "UsdPreviewSurface"
        token outputs:surface
{inputs}
    }}
{more}
}}
'''


BIND = 'def Mesh "square" (prepend apiSchemas = ["MaterialBindingAPI"]) {{{}\n        rel material:binding = </paint>\n{}\n}}\n'
UVS = (
    "texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = \"faceVarying\")\n"
    "int[] primvars:st:indices = [0, 1, 2, 3]"
)


def texture(key: str, output: str, file: str, more: str = "") -> tuple[str, str]:
    """The input that is connected to a texture, and the shaders behind it."""
    kind = {"rgb": "color3f", "r": "float", "g": "float", "a": "float"}[output]
    inputs = f"        {kind} inputs:{key}.connect = </paint/{key}.outputs:{output}>"
    shader = f'''    def Shader "{key}" {{
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @{file}@
        float2 inputs:st.connect = </paint/reader.outputs:result>
        {kind} outputs:{output}
        {more}
    }}
'''
    return inputs, shader


READER = '''    def Shader "reader" {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }
'''


def test_a_preview_surface_is_a_material(tmp_path):
    inputs = (
        "color3f inputs:diffuseColor = (0.8, 0.4, 0.2)\nfloat inputs:metallic = 0.25\nfloat inputs:roughness = 0.75\n"
        "float inputs:ior = 2\ncolor3f inputs:emissiveColor = (3, 1.5, 0)\nfloat inputs:clearcoat = 1"
    )
    made = read(tmp_path, usda(surface(inputs) + BIND.format(SQUARE, "")))
    material = made.parts[0].material
    assert isinstance(material, Ggx)
    np.testing.assert_allclose(material.base_color, [0.8, 0.4, 0.2], rtol=1e-6)
    np.testing.assert_allclose([material.metallic, material.roughness, material.reflectance], [0.25, 0.75, 1 / 9], rtol=1e-6)
    np.testing.assert_allclose(material.emission, [3, 1.5, 0], rtol=1e-6)
    assert "scene.usda: material paint: its clearcoat is not drawn" in made.unsupported


def test_textures_lie_where_the_file_says_and_share_images_as_gltf_has_them(tmp_path):
    (tmp_path / "maps").mkdir()
    colour = np.zeros((4, 4, 3), np.uint8)
    colour[0, 0] = 255, 0, 0  # the upper left
    Image.fromarray(colour).save(tmp_path / "maps" / "colour.png")
    Image.fromarray(np.full((2, 2), 51, np.uint8)).save(tmp_path / "rough.png")
    pairs = [texture("diffuseColor", "rgb", "./maps/colour.png"), texture("roughness", "r", "rough.png")]
    text = surface("\n".join(a for a, _ in pairs), more="".join(b for _, b in pairs) + READER) + BIND.format(SQUARE, UVS)
    part = read(tmp_path, usda(text)).parts[0]
    material = part.material
    assert isinstance(material, Ggx)
    assert material.colour_map is not None
    assert material.metallic_roughness_map is not None
    texels = material.colour_map.texels
    assert texels[3, 0, 0] == 1  # the first row is at the bottom
    assert texels[..., 0].sum() == 1
    np.testing.assert_allclose(material.metallic_roughness_map.texels[..., 1] * material.roughness, 0.2, atol=2e-3)
    assert material.metallic == 0
    by_place = {tuple(p): uv for p, uv in zip(part.geometry.positions[:, :2].tolist(), part.geometry.uvs.tolist(), strict=True)}
    np.testing.assert_allclose([by_place[-1, -1], by_place[1, 1]], [[0, 0], [1, 1]], atol=1e-6)


def test_an_opacity_texture_cuts_holes(tmp_path):
    Image.fromarray(np.array([[0, 255]], np.uint8)).save(tmp_path / "mask.png")
    inputs, shader = texture("opacity", "r", "mask.png")
    text = surface(f"{inputs}\nfloat inputs:opacityThreshold = 0.5", more=shader + READER) + BIND.format(SQUARE, UVS)
    material = read(tmp_path, usda(text)).parts[0].material
    assert isinstance(material, Ggx)
    assert material.alpha_test is not None
    assert material.alpha_test.cutoff == 0.5
    assert material.alpha_test.image is not None
    assert material.alpha_test.image.texels[0, :, 3].tolist() == [0, 1]


def test_display_colours_of_every_interpolation(tmp_path):
    for interpolation, values in (("constant", 1), ("uniform", 1), ("vertex", 4), ("faceVarying", 4)):
        colours = ", ".join(["(0.5, 0.25, 1)"] * values)
        shown = f'color3f[] primvars:displayColor = [{colours}] (interpolation = "{interpolation}")'
        part = read(tmp_path, usda(mesh("square", shown))).parts[0]
        assert part.geometry.colours is not None
        np.testing.assert_allclose(part.geometry.colours[:, :3], np.tile([0.5, 0.25, 1], (len(part.geometry.colours), 1)), atol=1e-6)
    wrong = "color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0)] (interpolation = \"vertex\")"
    made = read(tmp_path, usda(mesh("square", wrong)))
    assert any("displayColor of square is left out" in line for line in made.unsupported)


def test_subsets_have_their_own_materials(tmp_path):
    two = SQUARE.replace("[4]", "[3, 3]").replace("[0, 1, 2, 3]", "[0, 1, 2, 0, 2, 3]")
    subset = '''    def GeomSubset "half" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        uniform token elementType = "face"
        uniform token familyName = "materialBind"
        int[] indices = [1]
        rel material:binding = </other>
    }'''
    text = surface("color3f inputs:diffuseColor = (1, 0, 0)") + surface("color3f inputs:diffuseColor = (0, 1, 0)", "other")
    parts = read(tmp_path, usda(text + BIND.format(two, subset))).parts
    assert [part.material.base_color[:2] for part in parts] == [(1, 0), (0, 1)]  # type: ignore[union-attr]
    assert [len(part.geometry.triangles) for part in parts] == [1, 1]


def test_references_instances_and_point_instances(tmp_path):
    (tmp_path / "parts").mkdir()
    thing = usda('def Xform "thing" {\n' + mesh("square") + "}").replace(")\n", '    defaultPrim = "thing"\n)\n', 1)
    (tmp_path / "parts" / "thing.usda").write_text(thing)
    reference = 'def "{}" (instanceable = true\n    prepend references = @./parts/thing.usda@) {{\n'
    order = '    double3 xformOp:translate = ({}, 0, 0)\n    uniform token[] xformOpOrder = ["xformOp:translate"]\n}}\n'
    instancer = '''def PointInstancer "many" {
    int[] protoIndices = [0, 0, 0]
    point3f[] positions = [(0, 0, 10), (0, 0, 20), (0, 0, 30)]
    rel prototypes = </many/proto>
    int64[] invisibleIds = [1]
    def "proto" (prepend references = @./parts/thing.usda@) {}
}
'''
    two = reference.format("a") + order.format(5) + reference.format("b") + order.format(9)
    parts = read(tmp_path, usda(two + instancer)).parts
    places = sorted(tuple(np.round(part.geometry.positions.mean(axis=0), 4).tolist()) for part in parts)
    assert places == [(0, 0, 10), (0, 0, 30), (5, 0, 0), (9, 0, 0)]


def test_what_is_hidden_or_of_another_purpose_is_not_drawn(tmp_path):
    hidden = mesh("hidden", 'token visibility = "invisible"') + mesh("guide", 'uniform token purpose = "guide"')
    made = read(tmp_path, usda(hidden + mesh("seen") + 'def Sphere "ball" {}\ndef DistantLight "sun" {}\n'))
    assert len(made.parts) == 1
    assert "scene.usda: ball is left out: Sphere is not drawn; make it a mesh" in made.unsupported
    assert "scene.usda: its lights are not drawn; give the scene a [[luminaire]]" in made.unsupported


def test_cameras_are_presets_and_time_samples_animation(tmp_path):
    camera = '''def Camera "Front" {
    float focalLength = 50
    float verticalAperture = 36.4
    double3 xformOp:translate = (0, 1, 8)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def Xform "swing" {
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 25: (4, 0, 0) }
    float xformOp:rotateZ.timeSamples = { 1: 0, 25: 90 }
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
'''
    range_s = 'metersPerUnit = 1\n    upAxis = "Y"\n    startTimeCode = 1\n    endTimeCode = 25\n    timeCodesPerSecond = 24'
    made = read(tmp_path, usda(camera + mesh("square") + "}", range_s))
    assert [(c.name, round(c.fov_y_deg or 0, 2)) for c in made.cameras] == [("Front", 40.0)]
    np.testing.assert_allclose(made.cameras[0].file_from_camera[:3, 3], [0, 1, 8])
    (tmp_path / "scene.toml").write_text('[camera]\npreset = "Front"\n[[mesh]]\nfile = "scene.usda"\n')
    scene = load_scene(tmp_path / "scene.toml")
    for time_s, x in ((0.0, 0.0), (0.5, 2.0), (1.25, 1.0)):
        np.testing.assert_allclose(scene_pose(scene, time_s).matrices[0, :3, 3], [x, 0, 0], atol=1e-5)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(scene_pose(scene, 0.5).matrices[0, :3, 0], [half, 0, half], atol=1e-5)  # about the file's z, the world's -y


@pytest.fixture
def folder(tmp_path) -> Path:
    """A folder with a link out of it, beside a scene that it must not read."""
    outside, folder = tmp_path / "outside", tmp_path / "scene"
    outside.mkdir()
    folder.mkdir()
    for path in (tmp_path / "other.usda", outside / "other.usda"):
        path.write_text(usda(mesh("secret")))
    (folder / "link").symlink_to(outside)
    return folder


@pytest.mark.parametrize("reference", ["../other.usda", "/etc/passwd", "https://example.com/a.usda", "link/other.usda"])
def test_layers_outside_the_folder_are_refused(folder, reference):
    line = refused(folder, usda(mesh("square"), f"subLayers = [@{reference}@]"))
    assert "leads out of the folder" in line or "is an address" in line


INPUT, SHADER = texture("diffuseColor", "rgb", "../other.usda")


@pytest.mark.parametrize("text", [
    usda(mesh("square"), "customLayerData = { asset a = @../other.usda@ }"),
    usda('def "a" (prepend references = @../other.usda@) {}'),
    usda('def "a" (prepend payload = @../other.usda@) {}'),
    usda(surface(INPUT, more=SHADER + READER) + BIND.format(SQUARE, UVS)),
])  # fmt: skip
def test_every_way_to_name_a_file_is_looked_at(folder, text):
    assert "leads out of the folder" in refused(folder, text)


def test_a_reference_of_a_reference_is_looked_at(tmp_path):
    folder = tmp_path / "scene"
    folder.mkdir()
    (tmp_path / "other.usda").write_text(usda(mesh("secret")))
    (folder / "b.usda").write_text(usda('def "b" (prepend references = @../other.usda@) {}'))
    assert "leads out of the folder" in refused(folder, usda('def "a" (prepend references = @./b.usda@</b>) {}'))


def test_packages(tmp_path):
    from pxr import UsdUtils  # pyright: ignore[reportMissingImports]

    Image.fromarray(np.full((2, 2, 3), 255, np.uint8)).save(tmp_path / "white.png")
    inputs, shader = texture("diffuseColor", "rgb", "white.png")
    (tmp_path / "scene.usda").write_text(usda(surface(inputs, more=shader + READER) + BIND.format(SQUARE, UVS)))
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "scene.usda"), str(tmp_path / "scene.usdz"))
    material = read_meshes(tmp_path / "scene.usdz", "scene.toml").parts[0].material
    assert isinstance(material, Ggx)
    assert material.colour_map is not None
    with zipfile.ZipFile(tmp_path / "packed.usdz", "w", zipfile.ZIP_DEFLATED) as package:
        package.write(tmp_path / "scene.usda", "scene.usda")
    with pytest.raises(UserError, match="is compressed or encrypted"):
        read_meshes(tmp_path / "packed.usdz", "scene.toml")


def test_a_reader_that_ends_is_one_line(tmp_path, monkeypatch):
    for text in ("", "#usda 1.0\ndef Mesh {", "PXR-USDC" + "\0" * 100):
        assert "is no USD layer" in refused(tmp_path, text)
    assert "has no triangles" in refused(tmp_path, usda(""))
    bad = SQUARE.replace("[0, 1, 2, 3]", "[0, 1, 2, 7]")
    assert "points that it does not have" in refused(tmp_path, usda(mesh("bad", square=bad)))
    monkeypatch.setattr(usd_files.sys, "executable", "/bin/false")
    assert "usd-core could not read it (exit status 1)" in refused(tmp_path, usda(mesh("square")))


def test_without_usd_core_the_line_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setattr(usd_files.importlib.util, "find_spec", lambda _: None)
    assert "pip install 'vemlight[usd]'" in refused(tmp_path, usda(mesh("square")))
