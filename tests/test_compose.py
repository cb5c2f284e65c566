"""The compose file and what it starts, read as files: no container engine is needed."""

from pathlib import Path

import pytest

from vemlight.fuse.rig_file import read_camera_rig
from vemlight.runtime.channels import SERVICES
from vemlight.runtime.transport import endpoint
from vemlight.settings_file import read_settings

yaml = pytest.importorskip("yaml")
ROOT = Path(__file__).parents[1]
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
CONTAINERS = COMPOSE["services"]
RIG = yaml.safe_load((ROOT / "deploy" / "rig" / "compose.yml").read_text())["services"]
CAMERAS = {name: container for name, container in RIG.items() if name.startswith("capture-")}
NETWORK = "${VEMLIGHT_NET:-10.213.7}"


def test_each_service_has_a_container_and_only_the_keys_have_another():
    assert CONTAINERS.keys() == {*SERVICES, "keys"}


@pytest.mark.parametrize("name", sorted({**CONTAINERS, **CAMERAS}))
def test_a_container_may_do_no_more_than_its_work(name):
    container = {**CONTAINERS, **CAMERAS}[name]
    assert container["user"] == "10001:10001"
    assert container["cap_drop"] == ["ALL"]
    assert container["security_opt"] == ["no-new-privileges:true"]
    assert container["read_only"] is True
    assert [mount.partition(":")[0] for mount in container["tmpfs"]] == ["/tmp"]
    assert container["init"] is True
    assert 0 < container["pids_limit"] <= 256
    assert container["mem_limit"] in ("512m", "1g")
    forbidden = {"privileged", "cap_add", "pid", "ipc", "devices", "userns_mode", "env_file"}
    assert not forbidden & container.keys()
    assert container.get("network_mode") in (None, "none")


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_says_how_it_fares_and_comes_back(name):
    container = CONTAINERS[name]
    assert container["command"] == [name, "/settings/vemlight.toml"]
    assert container["healthcheck"]["test"] == ["CMD", "vemlight", "health", name, "/settings/vemlight.toml"]
    assert container["restart"] == "unless-stopped"
    assert container["depends_on"]["keys"] == {"condition": "service_completed_successfully"}
    assert all(volume.endswith(":ro") for volume in container["volumes"])


def test_only_the_page_is_published_and_only_to_this_machine():
    published = {name: container["ports"] for name, container in CONTAINERS.items() if "ports" in container}
    assert published == {"viewer": ["127.0.0.1:${VEMLIGHT_PORT:-8080}:8080"]}
    assert COMPOSE["networks"]["wire"]["internal"] is True
    assert [name for name in SERVICES if "page" in CONTAINERS[name]["networks"]] == ["viewer"]


def test_every_container_finds_the_others_without_dns():
    addresses = {name: CONTAINERS[name]["networks"]["wire"]["ipv4_address"] for name in SERVICES}
    assert len(set(addresses.values())) == len(SERVICES)
    assert all(address.startswith(f"{NETWORK}.") for address in addresses.values())
    for name in SERVICES:
        assert dict(entry.split(":", 1) for entry in _plain(CONTAINERS[name]["extra_hosts"])) == _plain_values(addresses)


def _plain(entries: list[str]) -> list[str]:
    return [entry.replace(NETWORK, "net") for entry in entries]


def _plain_values(addresses: dict[str, str]) -> dict[str, str]:
    return {name: address.replace(NETWORK, "net") for name, address in addresses.items()}


def test_the_settings_are_those_of_the_compose_file():
    settings = read_settings(ROOT / "deploy" / "vemlight.toml")
    assert settings.wire.keys == "/keys"
    assert not settings.wire.insecure
    assert settings.viewer.port == 8080
    assert settings.viewer.insecure  # no token, as the page is published to this machine only
    for name in SERVICES:
        assert endpoint(settings.wire, name, "publish").startswith(f"tcp://{name}:")
        assert "keys:/keys:ro" in CONTAINERS[name]["volumes"]
    assert CONTAINERS["keys"]["volumes"] == ["keys:/keys"]


def test_a_rig_has_a_container_a_camera_in_place_of_the_single_one():
    settings = read_settings(ROOT / "deploy" / "rig" / "vemlight.toml")
    rig = read_camera_rig(Path(settings.rig.file))
    assert list(CAMERAS) == [f"capture-{camera.name}" for camera in rig.camera]
    assert RIG["capture"] == {"profiles": ["single"]}  # which nobody starts
    for camera, container in zip(rig.camera, CAMERAS.values(), strict=True):
        name = f"capture.{camera.name}"
        assert container["command"] == ["capture", "/settings/vemlight.toml", camera.name]
        assert container["healthcheck"]["test"] == ["CMD", "vemlight", "health", name, "/settings/vemlight.toml"]
        assert endpoint(settings.wire, name, "publish").startswith(f"tcp://capture-{camera.name}:")
        assert all(volume.endswith(":ro") for volume in container["volumes"])
        assert "ports" not in container


def test_all_containers_of_a_rig_read_the_same_settings():
    """Compose takes the volume of the second file for one of the first at the same place in the container."""
    ours = "${VEMLIGHT_SETTINGS:-./deploy/rig}:/settings:ro"
    containers = {name: container for name, container in RIG.items() if name != "capture"}
    assert containers.keys() == {*CAMERAS, "fuse", "sampler", "renderer", "viewer"}
    assert all(ours in container["volumes"] for container in containers.values())


def test_the_containers_of_a_rig_find_each_other_without_dns():
    addresses = {name: container["networks"]["wire"]["ipv4_address"] for name, container in CAMERAS.items()}
    others = {name: CONTAINERS[name]["networks"]["wire"]["ipv4_address"] for name in SERVICES}
    assert len({*addresses.values(), *others.values()}) == len(addresses) + len(others)
    for name in ("sampler", "renderer", "viewer", "fuse"):
        assert dict(entry.split(":", 1) for entry in _plain(RIG[name]["extra_hosts"])) == _plain_values(addresses)
    for container in CAMERAS.values():
        known = dict(entry.split(":", 1) for entry in _plain(container["extra_hosts"]))
        assert known.items() <= _plain_values({**others, **addresses}).items()
        assert known.keys() >= {*addresses, "fuse", "sampler", "renderer", "viewer"}


def test_the_image_is_unprivileged_and_its_packages_are_those_of_the_lock():
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    assert [line for line in lines if line.startswith("USER")] == ["USER 10001:10001"]
    last_root, user = max(k for k, line in enumerate(lines) if line.startswith("RUN")), lines.index("USER 10001:10001")
    assert last_root < user < next(k for k, line in enumerate(lines) if line.startswith("ENTRYPOINT"))
    assert any("--require-hashes -r requirements.lock" in line for line in lines)
    allowed = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    locks = ["requirements.lock", "requirements-build.lock"]
    assert allowed == ["services", "vemlight", "vemlight_client.py", "replay_data", "pyproject.toml", *locks, "README.md", "LICENSE"]
