"""The example for Kubernetes: its published schemas, names that must agree, and what a hardened pod has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from app.cli.main import _parser
from app.routes import probes
from app.settings import ServiceSettings

ROOT = Path(__file__).resolve().parents[2]
MANIFESTS: list[dict[str, Any]] = list(yaml.safe_load_all((ROOT / "docs/kubernetes.yaml").read_text()))
NAMES = [f"{each['kind']} {each['metadata']['name']}" for each in MANIFESTS]
DEPLOYMENTS = {each["metadata"]["name"]: each for each in MANIFESTS if each["kind"] == "Deployment"}
PODS: dict[str, dict[str, Any]] = {name: each["spec"]["template"]["spec"] for name, each in DEPLOYMENTS.items()}
CONTAINERS = [(name, each) for name, pod in PODS.items() for each in (*pod["initContainers"], *pod["containers"])]
COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())


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
        selector = manifest["spec"].get("selector")
        if selector is not None:
            wanted = selector.get("matchLabels", selector)
            selected = [name for name, has in labels.items() if wanted.items() <= has.items()]
            assert selected == [manifest["metadata"]["name"]]
    (scaler,) = (each for each in MANIFESTS if each["kind"] == "HorizontalPodAutoscaler")
    target = scaler["spec"]["scaleTargetRef"]["name"]
    assert scaler["spec"]["minReplicas"] == DEPLOYMENTS[target]["spec"]["replicas"]


def test_what_is_scaled_by_is_a_metric_of_ours() -> None:
    (scaler,) = (each for each in MANIFESTS if each["kind"] == "HorizontalPodAutoscaler")
    (metric,) = (each["external"]["metric"] for each in scaler["spec"]["metrics"])
    described = (ROOT / "app/metrics.py").read_text()
    assert f'GaugeMetricFamily("{metric["name"]}"' in described
    assert metric["selector"]["matchLabels"] == {"state": "queued"}


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
    (service,) = (each for each in MANIFESTS if each["kind"] == "Service")
    assert DEPLOYMENTS["liftwright-api"]["spec"]["replicas"] > 1
    assert service["spec"]["sessionAffinity"] == "ClientIP"


def test_the_service_is_where_the_api_listens() -> None:
    (service,) = (each for each in MANIFESTS if each["kind"] == "Service")
    (container,) = PODS["liftwright-api"]["containers"]
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    assert ports[service["spec"]["ports"][0]["targetPort"]] == ServiceSettings.model_fields["port"].default
