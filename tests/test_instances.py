"""Which processes a run has, what they are called, where they are reached, and whose frames they take."""

from pathlib import Path

import pytest
import tomli_w

from vemlight.errors import UserError
from vemlight.runtime.instances import camera_capture, instances, producer, started, upstream
from vemlight.runtime.transport import endpoint
from vemlight.settings import Settings, Wire, read_settings


@pytest.fixture
def rig(tmp_path):
    """Settings with a rig of two cameras; keywords replace sections."""
    cameras = [{"name": name, "source": f"{name}-maps", "at": [k, 0, 1]} for k, name in enumerate(("left", "right"))]
    (tmp_path / "rig.toml").write_text(tomli_w.dumps({"camera": cameras}))

    def made(**sections) -> Settings:
        (tmp_path / "vemlight.toml").write_text(tomli_w.dumps({"rig": {"file": "rig.toml"}, **sections}))
        return read_settings(tmp_path / "vemlight.toml")

    return made


def test_one_camera_is_called_as_ever():
    settings = Settings()
    assert instances(settings) == started(settings) == ("capture", "sampler", "renderer", "viewer")
    assert upstream(settings, "sampler") == ("capture",)
    assert producer(settings, "map") == ("capture", "map")
    assert endpoint(Wire(transport="tcp"), "sampler", "serve") == "tcp://127.0.0.1:5603"


def test_a_rig_has_a_capture_for_each_camera_and_fuse_before_the_sampler(rig):
    settings = rig()
    assert instances(settings) == ("capture.left", "capture.right", "fuse", "sampler", "renderer", "viewer")
    assert upstream(settings, "fuse") == ("capture.left", "capture.right")
    assert upstream(settings, "sampler") == ("fuse",)
    assert producer(settings, "map") == ("fuse", "map")
    assert producer(settings, "points") == ("fuse", "points")


def test_each_capture_reads_its_own_camera(rig, tmp_path):
    settings = rig(capture={"rows": 45, "record": "kept"})
    left = camera_capture(settings, "left")
    assert (left.source, left.rows, left.record) == (str(tmp_path / "left-maps"), 45, str(tmp_path / "kept" / "left"))
    for name, words in (("middle", "middle: .*has no such camera; name one of left, right"), ("", "several cameras; name one of")):
        with pytest.raises(UserError, match=words):
            camera_capture(settings, name)
    with pytest.raises(UserError, match="left: there is one camera; leave out left"):
        camera_capture(Settings(), "left")


def test_names_make_a_second_renderer_and_viewer_beside_the_sampler_of_another_run():
    wire = Wire(names={"renderer": "renderer.b", "viewer": "viewer.b"}, elsewhere=("capture", "sampler"))
    settings = Settings(wire=wire)
    assert instances(settings) == ("capture", "sampler", "renderer.b", "viewer.b")
    assert started(settings) == ("renderer.b", "viewer.b")
    assert upstream(settings, "renderer") == ("sampler",)


def test_every_instance_has_its_own_endpoint(rig, tmp_path):
    folder = tmp_path / "s"
    folder.mkdir(mode=0o700)
    assert endpoint(Wire(folder=str(folder)), "capture.left", "publish") == f"ipc://{folder}/capture.left.publish"
    wire = Wire(transport="tcp", insecure=True, ports={"capture.left": 5620}, hosts={"capture.left": "10.0.0.7", "capture": "10.0.0.8"})
    assert endpoint(wire, "capture.left", "publish") == "tcp://10.0.0.7:5620"
    assert endpoint(wire, "capture.left", "serve") == "tcp://10.0.0.7:5621"
    with pytest.raises(UserError, match=r"\[wire\] ports: has none for capture.right; .*\"capture.right\" = 5620"):
        endpoint(wire, "capture.right", "publish")
    long = Wire(folder=str(folder / ("n" * (100 - len(str(folder))))))
    with pytest.raises(UserError, match="too long a path"):
        endpoint(long, "capture.left", "publish")


@pytest.mark.parametrize(
    ("sections", "words"),
    [
        ({"capture": {"source": "a"}}, r"\[capture\] source: does not go with \[rig\] file: the rig's file has it"),
        ({"capture": {"ground": 0.2}}, r"\[capture\] ground: does not go with \[rig\] file: it is for one camera"),
        ({"capture": {"brackets": True}}, r"\[capture\] brackets: does not go"),
        ({"wire": {"names": {"capture": "capture.x"}}}, r"\[wire.names\] capture: the rig's cameras have the names"),
        ({"wire": {"names": {"renderer": "viewer.b"}}}, r'\[wire.names\] renderer = "viewer.b": is no name of a renderer'),
        ({"wire": {"renderers": ["sampler"]}}, r'\[wire\] renderers: "sampler" is no renderer'),
        ({"mode": "lossless", "wire": {"elsewhere": ["sampler"]}}, r'\[wire\] elsewhere: is for mode = "live"'),
        ({"wire": {"transport": "tcp", "insecure": True, "ports": {"capture.left": 5613}}}, "5613 of capture.left is taken by .wire. port"),
        ({"wire": {"ports": {"capture.left": 5700, "capture.right": 5701}}}, "5701 of capture.right is taken by capture.left"),
        ({"wire": {"ports": {"captre.left": 5700}}}, r"\[wire.ports\] captre.left: is no service"),
        ({"wire": {"names": {"renderer": "renderer.B"}}}, "renderer.B|names"),
    ],
)
def test_what_does_not_go_together_is_refused(rig, sections, words):
    with pytest.raises(UserError, match=words):
        rig(**sections)


@pytest.mark.parametrize("text", ["", "camera = 3", '[[camera]]\nname = "A B"\nsource = "x"\nat = [0, 0, 0]', "nonsense"])
def test_a_file_that_is_no_rig_is_one_line(tmp_path: Path, text):
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises(UserError, match=r"rig.toml") as caught:
        instances(_with_rig(tmp_path / "rig.toml"))
    assert "\n" not in str(caught.value)


def _with_rig(path: Path) -> Settings:
    settings = path.with_name("vemlight.toml")
    settings.write_text(tomli_w.dumps({"rig": {"file": str(path)}}))
    return read_settings(settings)
