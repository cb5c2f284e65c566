"""Which processes a run has, what they are called, where they are reached, and whose frames they take."""

import socket as network
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from tests.support.processes import free_port, vemlight
from vemlight.commands.run_checks import check_run
from vemlight.errors import UserError
from vemlight.light.images import write_exr
from vemlight.runtime.instances import arguments, camera_capture, instances, producer, started, upstream
from vemlight.runtime.transport import endpoint
from vemlight.settings import Settings, Wire
from vemlight.settings_file import read_settings

TCP = {"transport": "tcp", "insecure": True}
PORTS = {"capture.left": 5620, "capture.right": 5622}


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
        ({"wire": {"transport": "tcp", "insecure": True, "ports": {"capture.left": 5613}}}, "5613 of capture.left is taken by fuse"),
        ({"viewer": {"port": 5603}, "wire": {"transport": "tcp", "insecure": True}}, r"\[viewer\] port: 5603 is taken by sampler"),
        ({"capture": {"recordings": "."}}, r"\[capture\] recordings: does not go with \[rig\] file"),
        ({"wire": {"renderers": ["renderer.b", "renderer.b"]}}, r'renderers: "renderer.b" is there twice'),
        ({"wire": {"elsewhere": ["plate"]}}, r"elsewhere: plate is no part of these settings, which have no \[plate\] source"),
        ({"wire": {"hosts": {"sampler": "10.0.0.1:5602"}}}, r'\[wire.hosts\] sampler = "10.0.0.1:5602": is no host; .*without a port'),
        ({"wire": {"hosts": {"sampler": ""}}}, "is no host"),
        ({"wire": {**TCP, "ports": {"capture.left": 5700, "capture.right": 5701}}}, "5701 of capture.right is taken by capture.left"),
        ({"wire": {"ports": {"captre.left": 5700}}}, r"\[wire.ports\] captre.left: is no service"),
        ({"wire": {"names": {"renderer": "renderer.B"}}}, "renderer.B|names"),
        ({"wire": {"ports": PORTS}}, r'\[wire\] ports: is for transport = "tcp"; leave it out, or set that'),
        ({"wire": {"hosts": {"sampler": "10.0.0.1"}}}, r'\[wire\] hosts: is for transport = "tcp"'),
        ({"wire": {"port": 5700}}, r'\[wire\] port: is for transport = "tcp"'),
        ({"wire": {**TCP, "folder": "s"}}, r'\[wire\] folder: is for transport = "ipc"'),
        ({"mode": "lossless", "wire": {"renderers": ["renderer"]}}, r'\[wire\] renderers: is for mode = "live"'),
        ({"out": "o", "wire": {"elsewhere": ["renderer"]}}, r"\[wire\] elsewhere: renderer writes there what `out` is for"),
    ],
)
def test_what_does_not_go_together_is_refused(rig, sections, words):
    with pytest.raises(UserError, match=words):
        rig(**sections)


def test_one_port_may_be_taken_on_each_host(rig):
    hosts = {"capture.left": "10.0.0.1", "capture.right": "10.0.0.2", "viewer": "10.0.0.3"}
    wire = {"transport": "tcp", "insecure": True, "ports": {"capture.left": 5620, "capture.right": 5620}, "hosts": hosts}
    settings = rig(wire=wire, viewer={"port": 5603})
    assert endpoint(settings.wire, "capture.left", "publish") == "tcp://10.0.0.1:5620"
    assert endpoint(settings.wire, "capture.right", "publish") == "tcp://10.0.0.2:5620"


@pytest.mark.parametrize(
    ("wire", "words"),
    [
        ({"elsewhere": ["capture", "fuse", "sampler", "renderer", "viewer"]}, r"\[wire\] elsewhere: names all services"),
        ({"elsewhere": ["capture", "fuse"]}, r"\[wire\] elsewhere: .* set \[wire\] folder to the same one in both"),
        ({**TCP, "ports": {"capture.left": 5620}}, r"\[wire\] ports: has none for capture.right"),
        ({**TCP, "ports": {**PORTS, "capture.lft": 5624}}, "capture.lft: .*rig.toml has no such camera; name one of capture.left"),
        ({**TCP, "ports": PORTS, "hosts": {"capture.lft": "10.0.0.7"}}, r"\[wire.hosts\] capture.lft: .*has no such camera"),
        ({"folder": "rig.toml"}, "cannot hold the sockets"),
        ({"folder": "f" * 100}, "too long a path"),
    ],
)
def test_a_run_that_could_not_work_is_refused_in_one_line(rig, tmp_path, wire, words):
    for name in ("left", "right"):
        write_maps(tmp_path / f"{name}-maps")
    settings = rig(wire=wire, viewer={"port": free_port()})
    with pytest.raises(UserError, match=words) as caught:
        check_run(settings, tmp_path / "vemlight.toml", source_option=False)
    assert "\n" not in str(caught.value)


def test_of_what_runs_elsewhere_nothing_need_be_here(rig, tmp_path):
    """Its cameras may be on another machine, and its page on a port that is taken here."""
    wire = {**TCP, "ports": PORTS, "hosts": {"capture": "10.0.0.7"}, "elsewhere": ["capture", "fuse", "sampler", "viewer"]}
    with network.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        check_run(rig(wire=wire, viewer={"port": taken.getsockname()[1]}), tmp_path / "vemlight.toml", source_option=False)
    plain = {"elsewhere": ["capture", "sampler", "renderer"], "folder": str(tmp_path / "sockets")}
    alone = {"capture": {"source": "nowhere"}, "renderer": {"scene": "nowhere.toml"}, "viewer": {"port": free_port()}, "wire": plain}
    (tmp_path / "alone.toml").write_text(tomli_w.dumps(alone))
    check_run(read_settings(tmp_path / "alone.toml"), tmp_path / "alone.toml", source_option=False)


def test_options_of_a_source_are_for_the_run_that_has_it(tmp_path):
    (tmp_path / "wall.toml").write_text('[wire]\nfolder = "sockets"\nelsewhere = ["capture", "sampler"]\n')
    done = vemlight("run", str(tmp_path / "wall.toml"), "--frames", "3")
    assert (done.returncode, "elsewhere: capture runs elsewhere" in done.stderr) == (2, True)


def write_maps(folder: Path) -> None:
    folder.mkdir()
    write_exr(folder / "f_0.exr", np.ones((4, 8, 3), np.float32))


def test_two_cameras_of_one_machine_do_not_read_one_device(tmp_path):
    cameras = [{"name": name, "source": "/dev/null", "at": [k, 0, 1]} for k, name in enumerate(("left", "right"))]
    (tmp_path / "rig.toml").write_text(tomli_w.dumps({"camera": cameras}))
    with pytest.raises(UserError, match="cameras left and right both read /dev/null"):
        check_run(_with_rig(tmp_path / "rig.toml"), None, source_option=False)


def test_only_a_camera_of_a_rig_is_told_its_name(rig):
    settings = rig()
    assert [arguments(settings, name) for name in instances(settings)] == [("left",), ("right",), (), (), (), ()]
    named = Settings(wire=Wire(names={"capture": "capture.x"}))
    assert arguments(named, "capture.x") == ()


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
