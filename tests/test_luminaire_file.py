from pathlib import Path

import msgspec
import numpy as np
import OpenEXR
import pytest

from vemlight.errors import UserError
from vemlight.light.images import write_exr
from vemlight.renderer.luminaire import luminaire_file
from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.luminaire.luminaire_file import HEADER_ATTRIBUTE, read_luminaire, write_luminaire


def a_field() -> LightField:
    images = np.random.default_rng(1).normal(size=(2, 3, 5, 7, 3)).astype(np.float32)
    return LightField(images, "b-spline", 0.0075, (-0.01, 0.02), 0.05, (-0.07, -0.06, 0.07, 0.06), "photometric", "torch")


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_a_file_brings_back_what_was_written(tmp_path, dtype):
    field = a_field()._replace(images=a_field().images.astype(dtype))
    write_luminaire(tmp_path / "a.exr", field)
    got = read_luminaire(tmp_path / "a.exr")
    assert np.array_equal(got.images, field.images.astype(np.float32))
    assert got[1:] == field[1:]
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


def test_the_first_scanline_is_the_highest_t(tmp_path):
    field = a_field()._replace(images=np.zeros((1, 1, 5, 7, 3), np.float32))
    field.images[0, 0, 4, 6] = 1  # highest t, highest s
    write_luminaire(tmp_path / "a.exr", field)
    pixels = OpenEXR.File(str(tmp_path / "a.exr")).channels()["RGB"].pixels
    assert np.argwhere(pixels[..., 0]).tolist() == [[0, 6]]


def rewritten(path: Path, drop: int = 0, header: str | None = None, pixels=None, **changes) -> None:
    """Writes the field of `a_field` with a fault."""
    field = a_field()
    about = msgspec.structs.asdict(luminaire_file.header_of(field)) | changes
    text = msgspec.json.encode({"schema": "vemlight.luminaire/1", **about}).decode() if header is None else header
    parts = []
    for j, i in np.ndindex(2, 3):
        attributes = {"type": OpenEXR.scanlineimage, **({HEADER_ATTRIBUTE: text} if not parts else {})}
        image = pixels if pixels is not None and len(parts) == 4 else np.ascontiguousarray(field.images[j, i])
        parts.append(OpenEXR.Part(attributes, {"RGB": image}, f"image_{j}_{i}"))
    OpenEXR.File(parts[: len(parts) - drop]).write(str(path))


NAN = np.full((5, 7, 3), np.nan, np.float32)


@pytest.mark.parametrize(("fault", "said"), [
    ({"drop": 1}, "no RGB part image_1_2"),
    ({"header": "{"}, HEADER_ATTRIBUTE),
    ({"header": ""}, HEADER_ATTRIBUTE),
    ({"spacing_m": -1.0}, "spacing_m"),
    ({"basis": "haar"}, "basis"),
    ({"rows": 100_000}, "rows"),
    ({"rows": 33, "cols": 32}, "33 x 32 images are more than 1024"),
    ({"colour": "red"}, "colour"),
    ({"window_m": (0.1, 0.0, -0.1, 1.0)}, "empty"),
    ({"pixels": NAN}, "105 values are nan"),
])
def test_a_file_with_a_fault_is_refused_in_one_line(tmp_path, fault, said):
    rewritten(tmp_path / "bad.exr", **fault)
    with pytest.raises(UserError, match=said) as caught:
        read_luminaire(tmp_path / "bad.exr")
    assert "bad.exr" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_luminaire_is_refused(tmp_path):
    write_exr(tmp_path / "plain.exr", np.zeros((4, 4, 3), np.float32))
    with pytest.raises(UserError, match="without the attribute"):
        read_luminaire(tmp_path / "plain.exr")
    with pytest.raises(UserError, match="no such file"):
        read_luminaire(tmp_path / "none.exr")
    with pytest.raises(UserError, match="change the suffix"):
        write_luminaire(tmp_path / "a.png", a_field())
    write_luminaire(tmp_path / "cut.exr", a_field())
    data = (tmp_path / "cut.exr").read_bytes()
    for length in (0, 3, 40, len(data) // 3, len(data) - 9):
        (tmp_path / "cut.exr").write_bytes(data[:length])
        with pytest.raises(UserError, match=r"cut\.exr"):
            read_luminaire(tmp_path / "cut.exr")
