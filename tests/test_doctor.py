"""What `vemlight doctor` finds, on this machine and on simulated ones: each fault with a hint how to fix it."""

import os
import shutil
import socket
from importlib import metadata
from pathlib import Path

import msgspec
import pytest
import zmq

from tests.support.processes import vemlight
from tests.support.settings_files import with_section
from vemlight.capture import v4l2
from vemlight.commands import doctor
from vemlight.commands.doctor import Finding, examine
from vemlight.errors import UserError
from vemlight.renderer.gl import programs
from vemlight.renderer.rays import embree
from vemlight.runtime.channels import SERVICES
from vemlight.settings import Settings
from vemlight.settings_file import read_settings


def found(settings: Settings, what: str) -> list[Finding]:
    return [finding for finding in examine(settings) if finding.what == what]


def one(settings: Settings, what: str) -> Finding:
    (finding,) = found(settings, what)
    return finding


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    tmp_path.chmod(0o700)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    (tmp_path / "vemlight.toml").write_text(f'[wire]\nfolder = "{tmp_path}"\n[viewer]\nport = {port}\n')
    return read_settings(tmp_path / "vemlight.toml")


def test_all_checks_pass_on_this_machine(settings):
    findings = list(examine(settings))
    assert [finding for finding in findings if finding.grade == "fail" and finding.what != "camera"] == []
    assert all(bool(finding.hint) == (finding.grade != "pass") for finding in findings)
    assert all("\n" not in finding.found + finding.hint for finding in findings)
    named = {finding.what for finding in findings}
    assert {"system", "processor", "libraries", "libzmq", "OpenGL", "videos", "port of the viewer", "page", "sockets", "source"} <= named
    assert {"scene", "disk", "charts", "camera", "open files", "shadows"} <= named


def test_the_command_says_the_same_to_people_and_programs(settings, tmp_path):
    lines = vemlight("doctor", "--json", tmp_path / "vemlight.toml")
    findings = [msgspec.json.decode(line, type=Finding) for line in lines.stdout.splitlines()]
    assert lines.returncode == int(any(finding.grade == "fail" for finding in findings))
    shown = vemlight("doctor", tmp_path / "vemlight.toml").stdout
    for finding in findings:
        assert f"{finding.what}: {finding.found}" in shown or finding.what == "disk"  # which others fill meanwhile


def test_gl_says_version_and_way(settings):
    finding = one(settings, "OpenGL")
    assert ", OpenGL 4." in finding.found
    assert "through EGL" in finding.found


def test_a_machine_without_gl_gets_a_hint(settings, monkeypatch):
    def refuse():
        raise UserError("no OpenGL 4.3 (EGL: libEGL.so.1 not loaded; X server :0: no display); install it: apt-get install libegl1")

    monkeypatch.setattr(programs, "open_context", refuse)
    finding = one(settings, "OpenGL")
    assert finding.grade == "fail"
    assert finding.found == "no OpenGL 4.3 (EGL: libEGL.so.1 not loaded; X server :0: no display)"
    assert finding.hint == "install it: apt-get install libegl1"


def test_a_card_that_does_not_draw_is_named(settings, monkeypatch):
    open_context = programs.open_context
    monkeypatch.setattr(programs, "open_context", lambda: open_context()._replace(refused=["EGL device 0: eglInitialize failed (0x3001)"]))
    finding = one(settings, "OpenGL")
    if finding.grade == "pass":
        pytest.skip("a graphics card draws here")
    assert "EGL device 0: eglInitialize failed (0x3001)" in finding.found


def test_a_card_that_may_not_be_opened_is_named(settings, monkeypatch, tmp_path):
    card = tmp_path / "renderD128"
    card.touch()
    monkeypatch.setattr(programs, "closed_cards", lambda: [card])
    finding = one(settings, "OpenGL")
    if not any(name in finding.found for name in programs.SOFTWARE):
        pytest.skip("a graphics card draws here")
    assert (finding.grade, str(card) in finding.found, "usermod" in finding.hint) == ("warn", True, True)


@pytest.mark.parametrize(
    ("wanted", "there", "grade", "found"),
    [("auto", 1, "pass", "by rays"), ("auto", 0, "warn", "by maps"), ("maps", 0, "pass", "by maps"), ("rays", 0, "fail", "rays")],
)
def test_how_shadows_are_drawn_is_named(settings, monkeypatch, wanted, there, grade, found):
    if not any(name in one(settings, "OpenGL").found for name in programs.SOFTWARE):
        pytest.skip("a graphics card draws here")
    if not there:
        monkeypatch.setattr(embree, "library", lambda: None)
    finding = one(with_section(settings, "renderer", shadows=wanted), "shadows")
    assert (finding.grade, found in finding.found, bool(finding.hint)) == (grade, True, grade != "pass")


def test_without_embreex_the_libraries_pass(settings, monkeypatch):
    monkeypatch.setattr(metadata, "requires", lambda _: ["embreex>=4.4; platform_machine == 'x86_64'"])
    monkeypatch.setattr(metadata, "version", missing)
    assert one(settings, "libraries").grade == "pass"


def missing(name: str) -> str:
    raise metadata.PackageNotFoundError(name)


def test_missing_and_old_libraries(settings, monkeypatch):
    monkeypatch.setattr(metadata, "requires", lambda _: ["numpy>=2.999.1", "no-such-package>=1", "zzz>=1; extra == 'bench'", "av<19,>=18"])
    findings = list(examine(settings))
    assert [finding.what for finding in findings] == ["system", "processor", "libraries"]  # nothing else can be looked at
    assert findings[-1].found.startswith("numpy ")
    assert "older than 2.999.1; no-such-package is missing" in findings[-1].found
    assert "make env" in findings[-1].hint


@pytest.mark.parametrize(
    ("cores", "pages", "grade", "word"), [(1, 2**22, "warn", "all services"), (8, 2**17, "warn", "1 GB"), (2, 2**19, "pass", "")]
)
def test_a_small_machine(settings, monkeypatch, cores, pages, grade, word):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)))
    monkeypatch.setattr(os, "sysconf", lambda name: pages if name == "SC_PHYS_PAGES" else 4096)
    finding = one(settings, "processor")
    assert finding.grade == grade
    assert word in finding.hint


@pytest.mark.parametrize(("version", "grade"), [((4, 3, 4), "fail"), ((4, 3, 5), "pass")])
def test_a_libzmq_without_its_security_fixes_fails(settings, monkeypatch, version, grade):
    monkeypatch.setattr(zmq, "zmq_version_info", lambda: version)
    assert one(settings, "libzmq").grade == grade


def test_cameras(settings, monkeypatch):
    cameras = [
        v4l2.CameraInfo("/dev/video0", "Astro", ["Y12", "GREY"]),
        v4l2.CameraInfo("/dev/video1", "Strange", [], ("H264",)),
        v4l2.CameraInfo("/dev/video2", "Webcam", ["YUYV", "MJPG"], ("H264",), ("exposure_auto", "exposure_time_absolute", "gain")),
    ]
    monkeypatch.setattr(v4l2, "list_cameras", lambda: cameras)
    good, bad, webcam = found(settings, "camera")[:3]
    assert (good.grade, good.found) == (
        "pass", "/dev/video0: Astro, Y12, GREY; it has no control of its exposure; lock it at the camera"
    )  # fmt: skip
    assert (bad.grade, bad.found.endswith("no format that is read; not read: H264"), "Y16" in bad.hint) == ("warn", True, True)
    locks = "--control exposure_time_absolute=N locks its exposure"
    assert (webcam.grade, webcam.found) == ("pass", f"/dev/video2: Webcam, YUYV, MJPG; not read: H264; {locks}")


def test_a_taken_port(settings):
    with socket.create_server(("127.0.0.1", settings.viewer.port)):
        finding = one(settings, "port of the viewer")
    assert (finding.grade, "[viewer] port" in finding.hint) == ("fail", True)
    assert f"127.0.0.1:{settings.viewer.port}: Address already in use" in finding.found


def test_ports_of_the_wire_are_one_line(settings):
    with socket.create_server(("127.0.0.1", 0)) as holder:
        taken = holder.getsockname()[1]
        tcp = with_section(settings, "wire", transport="tcp", insecure=True, port=taken - 3)
        finding = one(tcp, "ports of the wire")
    assert (finding.grade, f":{taken}: " in finding.found, finding.hint.endswith("[wire] port")) == ("fail", True, True)
    elsewhere = with_section(settings, "wire", transport="tcp", insecure=True, hosts={"sampler": "10.0.0.7"}, port=taken - 3)
    assert f":{taken}" not in one(elsewhere, "ports of the wire").found  # the second of the sampler's, on another machine
    assert one(elsewhere, "sockets").grade == "warn"
    nowhere_here = with_section(settings, "wire", transport="tcp", insecure=True, hosts=dict.fromkeys(SERVICES, "10.0.0.7"))
    assert found(nowhere_here, "ports of the wire") == []


@pytest.mark.parametrize(
    ("viewer", "grade"), [({}, "pass"), ({"host": "0.0.0.0"}, "pass"), ({"host": "0.0.0.0", "insecure": True}, "warn")]
)
def test_who_sees_the_page(settings, viewer, grade):
    assert one(with_section(settings, "viewer", **viewer), "page").grade == grade


@pytest.mark.parametrize(
    ("section", "key", "what"), [("capture", "source", "source"), ("renderer", "scene", "scene")], ids=["source", "scene"]
)
def test_files_that_are_not_there(settings, tmp_path, section, key, what):
    finding = one(with_section(settings, section, **{key: str(tmp_path / "gone")}), what)
    assert (finding.grade, "gone" in finding.hint) == ("fail", True)


def test_the_disk_is_the_one_written_to(settings, tmp_path, monkeypatch):
    out = msgspec.structs.replace(settings, out=str(tmp_path / "not" / "yet"))
    assert one(out, "disk").found.endswith(f"free at {tmp_path}")
    for free, grade in ((4e8, "warn"), (5e9, "pass")):  # a run writes 6 MB a frame
        monkeypatch.setattr(shutil, "disk_usage", lambda _, free=free: shutil._ntuple_diskusage(2**40, 2**40 - int(free), int(free)))
        assert one(out, "disk").grade == grade
    monkeypatch.setattr(os, "access", lambda path, _: Path(path) != tmp_path)
    assert one(out, "disk").grade == "fail"


@pytest.mark.parametrize(("hard", "grade", "peers"), [(256, "warn", 42), (1023, "warn", 298), (1024, "pass", 298), (2**20, "pass", 2048)])
def test_open_files_and_the_peers_that_they_allow(settings, monkeypatch, hard, grade, peers):
    monkeypatch.setattr(doctor, "hard_file_limit", lambda: hard)
    finding = one(settings, "open files")
    assert finding.grade == grade
    assert f"raises to {hard}: up to {peers} peers" in finding.found
    assert ("LimitNOFILE" in finding.hint) == (grade == "warn")
