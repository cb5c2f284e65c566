"""The Kubernetes manifests and the compose file of archives, read as files: no cluster is needed."""

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import click
import pytest

from vemlight.commands.cli import main
from vemlight.fuse.rig_file import read_camera_rig
from vemlight.runtime.channels import Service
from vemlight.runtime.transport import ROLES, endpoint
from vemlight.settings import Wire
from vemlight.settings_file import read_settings

yaml = pytest.importorskip("yaml")
ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "deploy" / "k8s"
OF_RIG = ROOT / "deploy" / "k8s-rig"  # beside it: kustomize takes no base that a folder lies in
SERVICES: tuple[Service, ...] = ("capture", "sampler", "renderer", "viewer")
NAME = re.compile(r"[a-z]([-a-z0-9]{0,61}[a-z0-9])?")  # RFC 1123, as a Service's must be
KINDS = {
    "Namespace": "v1", "Service": "v1", "StatefulSet": "apps/v1", "Deployment": "apps/v1", "Job": "batch/v1",
    "Kustomization": "kustomize.config.k8s.io/v1beta1",
}  # fmt: skip
# The keys of the API, version 1.31, that we use, by where they stand.
POD = {"automountServiceAccountToken", "enableServiceLinks", "hostAliases", "securityContext", "initContainers", "containers", "volumes",
       "restartPolicy"}  # fmt: skip
CONTAINER = {
    "name",
    "image",
    "imagePullPolicy",
    "command",
    "args",
    "ports",
    "readinessProbe",
    "resources",
    "securityContext",
    "volumeMounts",
}
SPEC = {
    "Service": {"selector", "ports", "publishNotReadyAddresses"},
    "StatefulSet": {"replicas", "serviceName", "selector", "template"},
    "Deployment": {"replicas", "strategy", "selector", "template"},
    "Job": {"completionMode", "completions", "parallelism", "backoffLimit", "backoffLimitPerIndex", "podFailurePolicy", "template"},
}


def documents(folder: Path) -> list[dict[str, Any]]:
    return [document for path in sorted(folder.glob("*.yaml")) for document in yaml.safe_load_all(path.read_text())]


RIG = documents(OF_RIG)
DOCUMENTS = [*documents(FOLDER), *(document for document in RIG if document["kind"] != "Kustomization")]
WORKLOADS = {document["metadata"]["name"]: document for document in DOCUMENTS if document["kind"] in ("StatefulSet", "Deployment", "Job")}
KUSTOMIZATION = next(document for document in DOCUMENTS if document["kind"] == "Kustomization")


def pod(name: str) -> dict[str, Any]:
    return WORKLOADS[name]["spec"]["template"]["spec"]


def parsed(arguments: list[str], folder: Path) -> click.Context:
    """What our own command line makes of a container's arguments; its folders lie in `folder`."""
    (folder / "archive").mkdir(exist_ok=True)
    here = [str(folder) + argument if argument.startswith("/archive") else argument for argument in arguments]
    name, command, rest = main.resolve_command(click.Context(main), here)
    assert command
    return command.make_context(name, rest, parent=click.Context(main))


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document["kind"])
def test_documents_have_the_shape_of_their_kind(document):
    assert KINDS[document["kind"]] == document["apiVersion"]
    if document["kind"] == "Kustomization":
        return
    assert NAME.fullmatch(document["metadata"]["name"])
    if document["kind"] in SPEC:
        assert document["spec"].keys() <= SPEC[document["kind"]]
    if document["kind"] in ("StatefulSet", "Deployment"):
        assert document["spec"]["selector"]["matchLabels"] == document["spec"]["template"]["metadata"]["labels"]


@pytest.mark.parametrize("name", sorted(WORKLOADS))
def test_a_pod_may_do_no_more_than_its_work(name):
    spec = pod(name)
    assert spec.keys() <= POD
    assert spec["automountServiceAccountToken"] is False
    assert spec["securityContext"]["runAsUser"] == spec["securityContext"]["fsGroup"] == 10001  # as the image's user
    assert spec["securityContext"]["runAsNonRoot"] is True
    assert spec["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    volumes = {volume["name"] for volume in spec["volumes"]}
    for container in (*spec.get("initContainers", ()), *spec["containers"]):
        assert container.keys() <= CONTAINER
        assert NAME.fullmatch(container["name"])
        assert container["image"] == "vemlight"
        allowed = {"allowPrivilegeEscalation": False, "readOnlyRootFilesystem": True, "capabilities": {"drop": ["ALL"]}}
        assert container["securityContext"] == allowed
        assert {mount["name"] for mount in container["volumeMounts"]} <= volumes
    assert all(container["resources"]["limits"]["memory"] for container in spec["containers"])


@pytest.mark.parametrize("name", sorted(WORKLOADS))
def test_the_command_line_takes_what_a_pod_is_given(name, tmp_path):
    (container,) = pod(name)["containers"]
    assert "command" not in container  # the image's entry point stays, with its cache
    assert all(isinstance(argument, str) for argument in container["args"])
    parsed(container["args"], tmp_path)
    if probe := container.get("readinessProbe"):
        program, *arguments = probe["exec"]["command"]
        assert program == "vemlight"
        service, _, *instance = container["args"]
        assert parsed(arguments, tmp_path).params["service"] == ".".join([service, *instance])


@pytest.mark.parametrize(("name", "instance", "settings"), [
    *((name, name, "vemlight.toml") for name in SERVICES),
    ("capture-left", "capture.left", "../k8s-rig/vemlight.toml"), ("capture-right", "capture.right", "../k8s-rig/vemlight.toml"),
    ("fuse", "fuse", "../k8s-rig/vemlight.toml"),
])  # fmt: skip
def test_a_service_is_found_at_its_name_and_ports(name, instance, settings):
    wire = read_settings(FOLDER / settings).wire
    service = next(document for document in DOCUMENTS if document["kind"] == "Service" and document["metadata"]["name"] == name)
    assert service["spec"]["selector"] == WORKLOADS[name]["spec"]["template"]["metadata"]["labels"]
    (container,) = pod(name)["containers"]
    open_ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    for role in ROLES:
        address = endpoint(wire, instance, role)
        port = next(port for port in service["spec"]["ports"] if port["name"] == role)
        assert address == f"tcp://{name}:{port['port']}"
        assert port["targetPort"] == role
        assert open_ports[role] == port["port"]
    assert pod(name)["hostAliases"] == [{"ip": "0.0.0.0", "hostnames": [name]}]  # or it could not listen at its own name
    assert WORKLOADS[name]["spec"]["replicas"] == 1  # two would be one address with two senders
    service, *of_instance = instance.split(".")
    assert container["args"] == [service, "/settings/vemlight.toml", *of_instance]


def test_a_rig_has_a_stateful_set_a_camera_in_place_of_the_single_one():
    cameras = [camera.name for camera in read_camera_rig(OF_RIG / "rig.toml").camera]
    sets = [document["metadata"]["name"] for document in RIG if document["kind"] == "StatefulSet"]
    assert sets == [f"capture-{camera}" for camera in cameras]
    own = next(document for document in RIG if document["kind"] == "Kustomization")
    assert own["resources"][0] == "../k8s"
    assert {*own["resources"][1:], "kustomization.yaml"} == {path.name for path in (OF_RIG).glob("*.yaml")}
    removed = [yaml.safe_load(patch["patch"]) for patch in own["patches"]]
    assert [(one["kind"], one["metadata"]["name"], one["$patch"]) for one in removed] == [
        ("StatefulSet", "capture", "delete"), ("Service", "capture", "delete")
    ]  # fmt: skip
    (settings,) = own["configMapGenerator"]
    assert settings == {"name": "vemlight-settings", "behavior": "replace", "files": ["vemlight.toml", "rig.toml"]}
    assert read_settings(OF_RIG / "vemlight.toml").rig.file == str(OF_RIG / "rig.toml")


def test_a_camera_has_a_stateful_set_and_the_others_never_two_pods_at_once():
    assert {name: WORKLOADS[name]["kind"] for name in SERVICES} == {"capture": "StatefulSet", **dict.fromkeys(SERVICES[1:], "Deployment")}
    assert all(WORKLOADS[name]["spec"]["strategy"] == {"type": "Recreate"} for name in SERVICES[1:])


def test_keys_are_a_secret_that_only_the_owner_reads_in_the_pod():
    """`read_keys` refuses a key that others may read, and a Secret's files are readable for the group."""
    assert KUSTOMIZATION["secretGenerator"] == [{"name": "vemlight-keys", "files": ["keys/vemlight.key", "keys/vemlight.key_secret"]}]
    assert "deploy/k8s/keys/" in (ROOT / ".gitignore").read_text().splitlines()
    assert not any(document["kind"] == "Secret" for document in DOCUMENTS)
    for name in (*SERVICES, "capture-left", "capture-right", "fuse"):
        (copied,) = pod(name)["initContainers"]
        assert copied["command"][-1].startswith("install -m 600 -t /keys /secret/vemlight.key ")
        volumes = {volume["name"]: volume for volume in pod(name)["volumes"]}
        assert volumes["secret"]["secret"] == {"secretName": "vemlight-keys", "defaultMode": 0o440}
        assert volumes["keys"]["emptyDir"]["medium"] == "Memory"
        (container,) = pod(name)["containers"]
        assert "secret" not in {mount["name"] for mount in container["volumeMounts"]}


def test_the_kustomization_names_what_is_there():
    listed = set(KUSTOMIZATION["resources"])
    jobs = {"archive-maps.yaml", "archive-lights.yaml"}  # applied by hand, one behind the other
    assert listed | jobs | {"kustomization.yaml"} == {path.name for path in FOLDER.glob("*.yaml")}
    assert KUSTOMIZATION["configMapGenerator"] == [{"name": "vemlight-settings", "files": ["vemlight.toml"]}]
    assert KUSTOMIZATION["generatorOptions"] == {"disableNameSuffixHash": True}  # pods name them as they are


@pytest.mark.skipif(not shutil.which("kubectl"), reason="kubectl, which has kustomize in it, is not installed")
@pytest.mark.parametrize(("folder", "sets"), [("k8s", ["capture"]), ("k8s-rig", ["capture-left", "capture-right"])])
def test_kustomize_builds_what_is_applied(tmp_path, folder, sets):
    shutil.copytree(ROOT / "deploy", tmp_path / "deploy")
    (tmp_path / "deploy" / "k8s" / "keys").mkdir(exist_ok=True)
    for name in ("vemlight.key", "vemlight.key_secret"):
        (tmp_path / "deploy" / "k8s" / "keys" / name).write_text("a key")
    done = subprocess.run(["kubectl", "kustomize", str(tmp_path / "deploy" / folder)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    built = list(yaml.safe_load_all(done.stdout))
    assert sorted(each["metadata"]["name"] for each in built if each["kind"] == "StatefulSet") == sets
    assert all(each["metadata"].get("namespace", "vemlight") == "vemlight" for each in built)
    names = {each["metadata"]["name"] for each in built if each["kind"] in ("ConfigMap", "Secret")}
    assert names == {"vemlight-settings", "vemlight-keys"}


def test_the_settings_are_those_of_compose():
    of_pods, of_compose = (read_settings(path) for path in (FOLDER / "vemlight.toml", ROOT / "deploy" / "vemlight.toml"))
    assert of_pods == of_compose
    assert of_pods.wire != Wire()


def test_the_indices_of_the_job_share_all_chunks(tmp_path):
    spec = WORKLOADS["vemlight-maps"]["spec"]
    (container,) = pod("vemlight-maps")["containers"]
    options = parsed(container["args"], tmp_path).params
    assert spec["completionMode"] == "Indexed"
    assert options["indices"] == spec["completions"] == spec["parallelism"]
    assert options["maps_only"] is True
    assert options["index"] is None  # the engine's JOB_COMPLETION_INDEX
    assert container["resources"]["requests"]["cpu"] == str(options["workers"])  # not one for each of the node's processors
    (lights,) = pod("vemlight-lights")["containers"]
    behind = parsed(lights["args"], tmp_path).params
    assert behind["from_maps"] is True
    assert (behind["source"], behind["out"]) == (options["source"], options["out"])  # one plan
    for job in ("vemlight-maps", "vemlight-lights"):
        (rule,) = WORKLOADS[job]["spec"]["podFailurePolicy"]["rules"]
        assert rule["onExitCodes"]["values"] == [2]  # what a person must mend is not tried again
        assert pod(job)["restartPolicy"] == "Never"  # which that rule requires


def test_compose_shares_the_chunks_as_the_job_does(tmp_path):
    services = yaml.safe_load((ROOT / "deploy" / "archive.compose.yml").read_text())["services"]
    makers = [service for name, service in services.items() if name.startswith("maps-")]
    options = [parsed(service["command"], tmp_path).params for service in makers]
    assert {found["indices"] for found in options} == {len(makers)}
    assert sorted(service["environment"]["JOB_COMPLETION_INDEX"] for service in makers) == [str(k) for k in range(len(makers))]
    behind = services["lights"]
    assert parsed(behind["command"], tmp_path).params["from_maps"] is True
    assert behind["depends_on"].keys() == {name for name in services if name.startswith("maps-")}
    for service in services.values():
        assert service["user"] == "10001:10001"
        assert service["cap_drop"] == ["ALL"]
        assert service["network_mode"] == "none"
        assert service["read_only"] is True
