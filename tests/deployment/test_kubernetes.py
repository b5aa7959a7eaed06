"""The example for Kubernetes: its published schemas, names that must agree, and what a hardened pod has."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import kubernetes_validate
import pytest
import yaml

from app.cli.main import _options, _parser
from app.metrics import ServiceMetrics
from app.routes import probes
from app.settings import ServiceSettings
from tests.deployment.test_containers import FINAL, arguments
from tests.support.own_service import OwnService
from workers.settings import WorkerSettings
from workers.solver.warm_up import MARK
from workers.stores.job_queue import Depth

ROOT = Path(__file__).resolve().parents[2]
MANIFESTS: list[dict[str, Any]] = list(yaml.safe_load_all((ROOT / "docs/kubernetes.yaml").read_text()))
NAMES = [f"{each['kind']} {each['metadata']['name']}" for each in MANIFESTS]
DEPLOYMENTS = {each["metadata"]["name"]: each for each in MANIFESTS if each["kind"] == "Deployment"}
PODS: dict[str, dict[str, Any]] = {name: each["spec"]["template"]["spec"] for name, each in DEPLOYMENTS.items()}
CONTAINERS = [(name, each) for name, pod in PODS.items() for each in (*pod["initContainers"], *pod["containers"])]
ADAPTER: dict[str, Any] = yaml.safe_load((ROOT / "docs/prometheus-adapter.yaml").read_text())
COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())


def of_kind(kind: str) -> list[dict[str, Any]]:
    return [each for each in MANIFESTS if each["kind"] == kind]


@pytest.mark.parametrize("manifest", MANIFESTS, ids=NAMES)
@pytest.mark.parametrize("version", ["1.28", kubernetes_validate.latest_version()])
def test_a_manifest_is_as_its_published_schema_has_it(manifest: dict[str, Any], version: str) -> None:
    kubernetes_validate.validate(manifest, version, strict=True)


def test_a_member_that_there_is_not_is_refused() -> None:
    manifest = {**MANIFESTS[0], "spec": {**MANIFESTS[0]["spec"], "selectors": {}}}
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(manifest, "1.28", strict=True)


def test_whatever_selects_pods_selects_those_of_one_deployment() -> None:
    labels = {name: each["spec"]["template"]["metadata"]["labels"] for name, each in DEPLOYMENTS.items()}
    for manifest in MANIFESTS:
        selector = manifest["spec"].get("selector", manifest["spec"].get("podSelector"))
        if selector is not None:
            wanted = selector.get("matchLabels", selector)
            selected = [name for name, has in labels.items() if wanted.items() <= has.items()]
            assert selected == [manifest["metadata"]["name"]]


def test_how_many_there_are_is_said_once() -> None:
    """Each `kubectl apply` would set back what the autoscaler has chosen."""
    scaled = {each["spec"]["scaleTargetRef"]["name"] for each in of_kind("HorizontalPodAutoscaler")}
    assert scaled == {"liftwright-worker"}
    for name, deployment in DEPLOYMENTS.items():
        assert ("replicas" in deployment["spec"]) == (name not in scaled)


def test_what_is_scaled_by_are_metrics_of_ours_and_each_is_one_number_however_many_apis_tell_it() -> None:
    (scaler,) = of_kind("HorizontalPodAutoscaler")
    metrics = [each["external"]["metric"] for each in scaler["spec"]["metrics"]]
    told = ServiceMetrics(Depth(3, 0, 2), Depth(7, 0, 1), {}, ()).collect()
    samples = {(each.name, each.labels["state"]): each.value for family in told for each in family.samples}
    values = [samples[metric["name"], metric["selector"]["matchLabels"]["state"]] for metric in metrics]
    assert values == [3.0, 7.0]
    (rule,) = ADAPTER["rules"]["external"]
    series = re.match(r'\{__name__=~"([^"]+)"', rule["seriesQuery"])
    assert series is not None
    assert all(re.fullmatch(series[1], metric["name"]) for metric in metrics)
    # The autoscaler adds up what it is given, so that the queue would count as often as there are APIs.
    assert re.fullmatch(r"max\(<<\.Series>>\{<<\.LabelMatchers>>\}\)", rule["metricsQuery"])
    assert rule["resources"] == {"overrides": {"namespace": {"resource": "namespace"}}}


def settings_of(name: str, monkeypatch: pytest.MonkeyPatch) -> ServiceSettings:
    """Return the settings that a deployment's container has, but for its database."""
    (container,) = PODS[name]["containers"]
    for each in container["env"]:
        if "value" in each:
            monkeypatch.setenv(each["name"], each["value"])
    return ServiceSettings(**_options(_parser().parse_args(container["command"][1:])))


def test_what_collects_metrics_and_what_probes_get_answers_without_a_key_and_by_address(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = settings_of("liftwright-api", monkeypatch)
    told = {name: getattr(settings, name) for name in ("host", "allowed_hosts", "metrics_without_key")}
    annotations = DEPLOYMENTS["liftwright-api"]["spec"]["template"]["metadata"]["annotations"]
    (container,) = PODS["liftwright-api"]["containers"]
    assert annotations["prometheus.io/scrape"] == "true"
    assert annotations["prometheus.io/port"] == str(container["ports"][0]["containerPort"])
    probed = {each["httpGet"]["path"] for member, each in container.items() if member.endswith("Probe")}
    service = OwnService(tmp_path, **told)
    service.begin_anew()
    try:
        for path in {annotations["prometheus.io/path"], *probed}:
            assert service.ask("GET", path, headers={"Host": "10.1.2.3:8040"}).status_code == 200, path
        (named,) = of_kind("Service")
        for host, status in {named["metadata"]["name"]: 401, "localhost": 401, "evil.example": 421}.items():
            assert service.ask("GET", "/v1/plans", headers={"Host": host}).status_code == status
    finally:
        service.end()


def test_who_reaches_the_port_that_tells_metrics_is_named() -> None:
    policies = {each["metadata"]["name"]: each["spec"] for each in of_kind("NetworkPolicy")}
    assert set(policies) == set(DEPLOYMENTS)
    assert all(policy["policyTypes"] == ["Ingress"] for policy in policies.values())
    (let_in,) = policies["liftwright-api"]["ingress"]
    (container,) = PODS["liftwright-api"]["containers"]
    assert [port["port"] for port in let_in["ports"]] == [container["ports"][0]["name"]]
    assert let_in["from"], "nothing here would let everybody in"
    assert "ingress" not in policies["liftwright-worker"], "nothing here lets nobody in"


@pytest.mark.parametrize("name", DEPLOYMENTS)
def test_what_was_compiled_and_computed_in_the_image_is_there_when_a_pod_starts(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The init container's own command is run, on folders that stand for the image's and for the volume.

    A volume is root's, and may be written to by the pod's group.
    """
    image = dict(pair.split("=", 1) for line in arguments("ENV", FINAL) for pair in shlex.split(line))
    monkeypatch.setenv("LIFTWRIGHT_DATA_DIR", image["LIFTWRIGHT_DATA_DIR"])
    kept = {Path(image["NUMBA_CACHE_DIR"]) / "planners_1" / "kernel.nbi", WorkerSettings().handovers_dir / MARK}
    (init,), (container,) = PODS[name]["initContainers"], PODS[name]["containers"]
    (mount,) = init["volumeMounts"]
    user = PODS[name]["securityContext"]["runAsUser"]
    with TemporaryDirectory() as folder:
        root = Path(folder)
        for file in kept:
            below(root / "image", file).parent.mkdir(parents=True, exist_ok=True)
            below(root / "image", file).write_text("made in the image")
        volume = below(root / "image", Path(mount["mountPath"]))
        volume.mkdir()
        who = {}
        if os.geteuid() == 0:
            who = {"user": user, "group": user, "extra_groups": ()}
            subprocess.run(["chown", "-R", f"{user}:{user}", root / "image"], check=True)
            os.chown(volume, 0, user)
        volume.chmod(0o2775)
        # From within: the way to the folder may be closed to others.
        words = [word.removeprefix("/") if word.startswith("/") else word for word in init["command"]]
        subprocess.run(words, cwd=root / "image", check=True, **who)
        for file in kept:
            places = [each for each in container["volumeMounts"] if file.is_relative_to(each["mountPath"])]
            place = max(places, key=lambda each: len(each["mountPath"]))
            assert place["name"] == mount["name"]
            there = volume / place.get("subPath", "") / file.relative_to(place["mountPath"])
            assert there.read_text() == "made in the image"
            assert there.stat().st_mtime_ns == below(root / "image", file).stat().st_mtime_ns


def below(folder: Path, absolute: Path) -> Path:
    return folder / absolute.relative_to("/")


def test_no_worker_is_ended_because_the_database_is_away() -> None:
    (container,) = PODS["liftwright-worker"]["containers"]
    words = {member: each["exec"]["command"][1:] for member, each in container.items() if member.endswith("Probe")}
    asks_the_process = {member: _parser().parse_args(each).alive for member, each in words.items()}
    assert asks_the_process == {"startupProbe": False, "readinessProbe": False, "livenessProbe": True}


@pytest.mark.parametrize(("name", "container"), CONTAINERS, ids=[f"{name} {each['name']}" for name, each in CONTAINERS])
def test_a_container_is_hardened_and_bounded(name: str, container: dict[str, Any]) -> None:
    pod, context = PODS[name], container["securityContext"]
    (user,) = {service["user"] for service in COMPOSE["services"].values() if "build" in service}
    assert pod["securityContext"]["runAsNonRoot"] is True
    assert pod["securityContext"]["runAsUser"] == int(user)
    assert pod["automountServiceAccountToken"] is False
    assert context["readOnlyRootFilesystem"] is True
    assert context["allowPrivilegeEscalation"] is False
    assert context["capabilities"] == {"drop": ["ALL"]}
    assert "memory" in container["resources"]["limits"]
    assert {mount["name"] for mount in container["volumeMounts"]} <= {volume["name"] for volume in pod["volumes"]}
    assert container["image"] == COMPOSE["services"]["api"]["image"]


@pytest.mark.parametrize("name", DEPLOYMENTS)
def test_variables_are_settings_and_commands_and_probes_are_ours(name: str) -> None:
    known = {f"LIFTWRIGHT_{field.upper()}" for field in ServiceSettings.model_fields}
    addresses = {getattr(route, "path", None) for route in probes.router.routes}
    (container,) = PODS[name]["containers"]
    assert {each["name"] for each in container["env"]} <= known
    commands = [container["command"]]
    for probe in (probe for member, probe in container.items() if member.endswith("Probe")):
        if "exec" in probe:
            commands.append(probe["exec"]["command"])
        else:
            assert probe["httpGet"]["path"] in addresses
            assert probe["httpGet"]["port"] in {port["name"] for port in container["ports"]}
    for program, *words in commands:
        assert program == "liftwright"
        assert _parser().parse_args(words).command == words[0]


def test_a_browser_comes_to_the_pod_that_draws_its_scene() -> None:
    (service,) = of_kind("Service")
    assert DEPLOYMENTS["liftwright-api"]["spec"]["replicas"] > 1
    assert service["spec"]["sessionAffinity"] == "ClientIP"


def test_the_service_is_where_the_api_listens() -> None:
    (service,) = of_kind("Service")
    (container,) = PODS["liftwright-api"]["containers"]
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    assert ports[service["spec"]["ports"][0]["targetPort"]] == ServiceSettings.model_fields["port"].default
