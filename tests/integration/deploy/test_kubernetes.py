"""The manifests of deploy/kubernetes, compared with Kubernetes' schemas, the images and the services."""

from __future__ import annotations

import copy
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from stampede_rt_channel_host.settings import HostSettings
from stampede_rt_channel_host.supervisor import STOP_SECONDS_MAX
from stampede_rt_frontend.settings import FrontendSettings
from stampede_rt_runtime.health import LIVENESS, READINESS
from stampede_rt_runtime.health_check import own_address
from stampede_rt_runtime.server import DRAIN_SECONDS
from stampede_rt_runtime.settings import load_settings
from stampede_rt_supernode.settings import SupernodeSettings
from stampede_rt_web.settings import WebSettings

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "deploy/kubernetes"
KUBERNETES_VERSIONS = ("1.30", "1.37")  # the oldest that the manifests support, and the newest with an installed schema
SECRET = b"a secret for the tests, which nobody else uses"
SETTINGS: dict[str, tuple[str, type[Any]]] = {
    "stampede-supernode": ("supernode", SupernodeSettings),
    "stampede-host": ("host", HostSettings),
    "stampede-frontend": ("frontend", FrontendSettings),
    "stampede-web": ("web", WebSettings),
}
IMAGES = {"stampede-host": "channel-host"}  # the other images have the name of their workload
Manifest = dict[str, Any]

pytestmark = pytest.mark.skipif(
    shutil.which("kubectl") is None, reason="kubectl, which has kustomize, is not installed"
)


@pytest.fixture(scope="module", params=["dev", "prod"])
def overlay(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[Manifest]:
    """All manifests of an overlay. The operator has made the secret."""
    folder = shutil.copytree(FOLDER, tmp_path_factory.mktemp("kubernetes") / "kubernetes")
    (folder / "components/secret/secret").write_bytes(SECRET)
    command = ["kubectl", "kustomize", folder / "overlays" / request.param]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # kustomize warns of deprecated fields
    return list(yaml.safe_load_all(done.stdout))


def of_kind(overlay: list[Manifest], *kinds: str) -> list[Manifest]:
    return [one for one in overlay if one["kind"] in kinds]


def workloads(overlay: list[Manifest]) -> dict[str, Manifest]:
    return {one["metadata"]["name"]: one for one in of_kind(overlay, "StatefulSet", "Deployment")}


def pod(workload: Manifest) -> Manifest:
    spec: Manifest = workload["spec"]["template"]["spec"]
    return spec


def container(workload: Manifest) -> Manifest:
    (one,) = pod(workload)["containers"]
    return dict(one)


def labels(workload: Manifest) -> dict[str, str]:
    found: dict[str, str] = workload["spec"]["template"]["metadata"]["labels"]
    return found


def environment(overlay: list[Manifest], workload: Manifest, ordinal: int = 0) -> dict[str, str]:
    """The variables of a pod, as kubelet makes them: from the image, the ConfigMap, and then in their order."""
    name = workload["metadata"]["name"]
    facts = {"metadata.name": f"{name}-{ordinal}", "metadata.namespace": workload["metadata"]["namespace"]}
    maps = {one["metadata"]["name"]: one["data"] for one in of_kind(overlay, "ConfigMap")}
    found = {}
    for source in container(workload).get("envFrom", []):
        found |= maps[source["configMapRef"]["name"]]
    for one in container(workload)["env"]:
        if "valueFrom" in one:
            found[one["name"]] = facts[one["valueFrom"]["fieldRef"]["fieldPath"]]
        else:
            found[one["name"]] = re.sub(r"\$\((\w+)\)", lambda match: found[match[1]], one["value"])
    return found


def replicas(workload: Manifest) -> int:
    return int(workload["spec"]["replicas"])


def settings(overlay: list[Manifest], name: str, ordinal: int = 0) -> Any:
    service, cls = SETTINGS[name]
    own = environment(overlay, workloads(overlay)[name], ordinal)
    return load_settings(cls, service=service, argv=[], environ=own)


def validate(manifest: Manifest) -> None:
    for version in KUBERNETES_VERSIONS:
        kubernetes_validate.validate(manifest, version, strict=True)


def test_every_manifest_has_the_form_that_kubernetes_knows(overlay: list[Manifest]) -> None:
    assert set(workloads(overlay)) == set(SETTINGS)
    for manifest in overlay:
        validate(manifest)


@pytest.mark.parametrize("mistake", [("replicas", "three"), ("podManagment", "Parallel"), ("serviceName", None)])
def test_the_schemas_refuse_mistakes(overlay: list[Manifest], mistake: tuple[str, Any]) -> None:
    broken = copy.deepcopy(workloads(overlay)["stampede-supernode"])
    broken["spec"][mistake[0]] = mistake[1]
    with pytest.raises(kubernetes_validate.ValidationError):
        validate(broken)


@pytest.mark.parametrize("name", SETTINGS)
def test_every_variable_is_a_setting_that_the_service_takes(overlay: list[Manifest], name: str) -> None:
    service = SETTINGS[name][0].upper()
    fields = [field.removesuffix("_nanos").upper() for field in vars(settings(overlay, name))]
    known = {f"STAMPEDE_{field}" for field in fields} | {f"STAMPEDE_{service}_{field}" for field in fields}
    clients = {f"STAMPEDE_TLS_{one}" for one in ("CA", "CERTIFICATE", "KEY")} if name == "stampede-web" else set()
    given = {one for one in environment(overlay, workloads(overlay)[name]) if one != "POD_NAMESPACE"}
    assert given <= known | clients


@pytest.mark.parametrize("name", SETTINGS)
def test_ports_and_images_agree_with_the_services(overlay: list[Manifest], name: str) -> None:
    one = container(workloads(overlay)[name])
    image = IMAGES.get(name, name.removeprefix("stampede-"))
    assert one["image"].partition(":")[0] == f"stampede-rt/{image}"
    dockerfile = (ROOT / f"deploy/docker/{image}.Dockerfile").read_text()
    port = int(settings(overlay, name).listen.rpartition(":")[2])
    assert f"\nEXPOSE {port}\n" in dockerfile
    given = {each["name"]: each["containerPort"] for each in one.get("ports", [])}
    assert given == ({} if name == "stampede-web" else {"grpc": port, "metrics": 9464})
    assert "command" not in one  # so the image's own command runs
    assert "args" not in one


def test_the_parts_know_each_other_by_names_that_services_give(overlay: list[Manifest]) -> None:
    services = {one["metadata"]["name"]: one["spec"] for one in of_kind(overlay, "Service")}
    count = replicas(workloads(overlay)["stampede-supernode"])
    supernodes = [f"stampede-supernode-{each}.stampede-supernode:7590" for each in range(count)]
    for ordinal in range(count):
        own = settings(overlay, "stampede-supernode", ordinal)
        assert own.members == tuple(f"{address.partition('.')[0]}={address}" for address in supernodes)
        assert own.advertise.startswith(f"{own.id}.stampede-supernode.")
    assert settings(overlay, "stampede-frontend").supernodes == tuple(supernodes)
    assert settings(overlay, "stampede-host").frontend == ("stampede-frontend:7580",)
    assert settings(overlay, "stampede-web").url == "stampede-frontend:7580"
    for name in ("stampede-supernode", "stampede-host"):
        assert workloads(overlay)[name]["spec"]["serviceName"] == name
        namespace = workloads(overlay)[name]["metadata"]["namespace"]
        assert f"-0.{name}.{namespace}.svc:" in settings(overlay, name).advertise
        assert services[name]["clusterIP"] == "None"
        assert services[name]["publishNotReadyAddresses"] is True
    assert [port["port"] for port in services["stampede-frontend"]["ports"]] == [7580]


def selectors(overlay: list[Manifest]) -> Iterator[tuple[str, dict[str, str]]]:
    for one in of_kind(overlay, "Service"):
        yield one["metadata"]["name"], one["spec"]["selector"]
    for one in of_kind(overlay, "PodDisruptionBudget", "StatefulSet", "Deployment"):
        yield one["metadata"]["name"], one["spec"]["selector"]["matchLabels"]


def test_every_selector_finds_the_pods_of_its_workload_and_no_others(overlay: list[Manifest]) -> None:
    for name, wanted in selectors(overlay):
        found = [each for each, one in workloads(overlay).items() if wanted.items() <= labels(one).items()]
        assert found == [name]
    budgets = {
        one["metadata"]["name"]: one["spec"]["maxUnavailable"] for one in of_kind(overlay, "PodDisruptionBudget")
    }
    assert budgets == dict.fromkeys(set(SETTINGS) - {"stampede-web"}, 1)


def test_the_network_policy_lets_in_only_members_and_clients_at_the_ports_of_the_services(
    overlay: list[Manifest],
) -> None:
    (policy,) = of_kind(overlay, "NetworkPolicy")
    chosen = policy["spec"]["podSelector"]["matchLabels"]
    assert all(chosen.items() <= labels(one).items() for one in workloads(overlay).values())
    assert set(policy["spec"]["policyTypes"]) == {"Ingress", "Egress"}
    calls, metrics = policy["spec"]["ingress"]
    assert [port["port"] for port in calls["ports"]] == [7580, 7590, 7600]
    assert [port["port"] for port in metrics["ports"]] == [9464]
    assert all("podSelector" in one for one in calls["from"])
    assert policy["spec"]["egress"][0]["ports"] == calls["ports"]


@pytest.mark.parametrize("name", ["stampede-supernode", "stampede-host", "stampede-frontend"])
def test_probes_ask_the_health_service_for_liveness_and_for_readiness(overlay: list[Manifest], name: str) -> None:
    one = container(workloads(overlay)[name])
    own = environment(overlay, workloads(overlay)[name])
    port = int(settings(overlay, name).listen.rpartition(":")[2])
    secured = any(each.endswith("_TLS_CA") for each in own)
    for probe, service in (("startupProbe", LIVENESS), ("livenessProbe", LIVENESS), ("readinessProbe", READINESS)):
        if secured:  # kubelet's own gRPC probes speak no TLS
            words = one[probe]["exec"]["command"]
            assert words[:3] == ["python3", "-m", "stampede_rt_runtime.health_check"]
            assert (words[3:] == ["--live"]) == (service == LIVENESS)
            assert own_address([], own) == f"127.0.0.1:{port}"
            assert "grpc" not in one[probe]
        else:
            assert one[probe]["grpc"] == {"port": port, "service": service}
    assert one["livenessProbe"]["failureThreshold"] * one["livenessProbe"]["periodSeconds"] >= 60


def test_kubernetes_waits_longer_for_the_end_than_the_services_take(overlay: list[Manifest]) -> None:
    found = workloads(overlay)
    drain = settings(overlay, "stampede-host").drain_seconds
    takes = {"stampede-host": drain + STOP_SECONDS_MAX, "stampede-frontend": 5 + 2 * DRAIN_SECONDS}
    for name, one in found.items():
        assert pod(one)["terminationGracePeriodSeconds"] >= takes.get(name, 2 * DRAIN_SECONDS + 2) + 5
    stop = container(found["stampede-frontend"])["lifecycle"]["preStop"]
    assert stop == {"exec": {"command": ["sleep", "5"]}}


@pytest.mark.parametrize("name", SETTINGS)
def test_a_pod_has_few_rights_and_bounded_memory(overlay: list[Manifest], name: str) -> None:
    workload = workloads(overlay)[name]
    one = container(workload)
    assert pod(workload)["automountServiceAccountToken"] is False
    assert pod(workload)["securityContext"]["runAsNonRoot"] is True
    assert pod(workload)["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert one["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    assert set(one["resources"]["requests"]) == {"cpu", "memory"}
    assert "memory" in one["resources"]["limits"]
    written = {mount["mountPath"] for mount in one["volumeMounts"] if not mount.get("readOnly")}
    assert written == {"/tmp"} | ({"/var/lib/stampede"} if workload["kind"] == "StatefulSet" else set())
    if workload["kind"] == "StatefulSet":
        assert settings(overlay, name).data_dir.is_relative_to("/var/lib/stampede")


def test_a_host_refuses_puts_long_before_its_container_is_out_of_memory(overlay: list[Manifest]) -> None:
    limit = container(workloads(overlay)["stampede-host"])["resources"]["limits"]["memory"]
    assert settings(overlay, "stampede-host").memory_bytes_max <= int(limit.removesuffix("Gi")) * 2**30 // 2


@pytest.mark.parametrize("name", SETTINGS)
def test_each_service_has_its_credentials_in_files_of_a_secret(overlay: list[Manifest], name: str) -> None:
    workload = workloads(overlay)[name]
    own = environment(overlay, workload)
    places = {mount["name"]: mount["mountPath"] for mount in container(workload)["volumeMounts"]}
    secrets = [one for one in pod(workload)["volumes"] if "secret" in one]
    assert [places[one["name"]] for one in secrets] == ["/run/stampede"]
    assert secrets[0]["secret"]["defaultMode"] == 0o440  # services refuse a file that every user may read
    files = {key: value for key, value in own.items() if re.search(r"SECRET_FILE|_TLS_", key)}
    assert files
    assert all(value.startswith("/run/stampede/") for value in files.values())
    made = [one["metadata"]["name"] for one in of_kind(overlay, "Secret")]
    if "STAMPEDE_SECRET_FILE" in own:
        assert [one["secret"]["secretName"] for one in secrets] == made
    else:  # the operator makes these secrets, as deploy/README.md says
        assert made == []
        (secret,) = (one["secret"]["secretName"] for one in secrets)
        assert secret == f"{name}-certificates"


def test_the_recipe_for_certificates_makes_the_files_that_the_pods_name(
    overlay: list[Manifest], tmp_path: Path
) -> None:
    text = (ROOT / "deploy/README.md").read_text()
    (recipe,) = (
        block for block in re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL) if "certs" in block
    )
    own = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    command = ["bash", "-euc", recipe.replace("| kubectl apply -f -", ">> secrets.yaml; echo --- >> secrets.yaml")]
    done = subprocess.run(command, cwd=tmp_path, env=own, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    secrets = yaml.safe_load_all((tmp_path / "secrets.yaml").read_text())
    made = {one["metadata"]["name"]: set(one["data"]) for one in secrets if one}
    for name, workload in workloads(overlay).items():
        for ordinal in range(3 if workload["kind"] == "StatefulSet" else 1):
            given = environment(overlay, workload, ordinal)
            named = {Path(value).name for key, value in given.items() if "_TLS_" in key}
            assert named <= made[f"{name}-certificates"]
            assert len(named) in (0, 3)
