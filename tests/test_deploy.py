"""What deploy/ holds names only what there is: metrics, settings, ports, paths, commands, and its own parts."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from fastapi.routing import APIRoute

from app.api.deps import public
from app.api.metrics import Metrics
from app.cli import COMMANDS
from app.main import create_app
from app.settings import Settings

ROOT = Path(__file__).parents[1]
DEPLOY = ROOT / "deploy"
KUBERNETES = DEPLOY / "kubernetes"
PREFIX = "ROOMFIX_"
# What else the image's process reads: uvicorn, the object store's client, Python and BLAS.
OTHER_VARIABLES = {
    "AWS_ACCESS_KEY_ID",
    "AWS_ALLOW_HTTP",
    "AWS_ENDPOINT_URL",
    "AWS_REGION",
    "AWS_SECRET_ACCESS_KEY",
    "FORWARDED_ALLOW_IPS",
    "OMP_NUM_THREADS",
    "PATH",
    "PYTHONUNBUFFERED",
}
# Where `${NAME}`, `${NAME:-default}` or `${NAME:?message}` stands.
INSERTED = re.compile(r"\$\{[A-Z_]+(?::([-?])([^}]*))?\}")
NAME = re.compile(r"\b(roomfix_[a-z_]+|process_[a-z_]+)\b")


@pytest.mark.parametrize("name", ["alerts.yml", "grafana-dashboard.json"])
def test_metrics_exist(name: str) -> None:
    named = set(NAME.findall((DEPLOY / name).read_text(encoding="utf-8")))
    known = set(re.findall(r"^# TYPE (\S+)", Metrics().render().decode(), re.MULTILINE))
    histograms = {f"{metric}_bucket" for metric in known}
    assert len(named) >= 6
    assert named <= known | histograms


@cache
def compose() -> dict[str, Any]:
    """Return docker-compose.yml."""
    return dict(yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8")))


@cache
def manifests() -> dict[tuple[str, str], dict[str, Any]]:
    """Return what Kustomize puts together, by kind and name."""
    names = yaml.safe_load((KUBERNETES / "kustomization.yaml").read_text(encoding="utf-8"))["resources"]
    found = [
        each for name in names for each in yaml.safe_load_all((KUBERNETES / name).read_text(encoding="utf-8"))
    ]
    by_name = {(each["kind"], each["metadata"]["name"]): each for each in found}
    assert len(by_name) == len(found)
    return by_name


def kustomization() -> dict[str, Any]:
    return dict(yaml.safe_load((KUBERNETES / "kustomization.yaml").read_text(encoding="utf-8")))


def containers() -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Yield each Deployment's pod and its container."""
    for (kind, _), each in manifests().items():
        if kind == "Deployment":
            pod = each["spec"]["template"]["spec"]
            yield from ((pod, container) for container in pod["containers"])


def own_services() -> dict[str, Any]:
    """Return the services of docker-compose.yml that run the image of this repository."""
    return {name: each for name, each in compose()["services"].items() if "build" in each}


def environments() -> dict[str, dict[str, str]]:
    """Return the variables of everything that runs the image, by where they stand."""
    docker = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    block = re.search(r"^ENV (.*?[^\\])$", docker, re.MULTILINE | re.DOTALL)
    assert block is not None
    pairs = [part.split("=", 1) for part in block[1].replace("\\\n", " ").split()]
    config = kustomization()["configMapGenerator"][0]["literals"]
    own = {each["name"]: each["value"] for _, container in containers() for each in container.get("env", [])}
    return {
        "Dockerfile": dict(pairs),
        "kubernetes": {**dict(literal.split("=", 1) for literal in config), **own},
        **{name: each["environment"] for name, each in own_services().items()},
    }


def routes() -> dict[str, APIRoute]:
    """Return the routes of the app that answer GET, by path."""
    app = create_app(Settings(_env_file=None, open=True))
    found: list[Any] = list(app.routes)
    for route in found:
        found += getattr(getattr(route, "original_router", None), "routes", [])
    return {
        route.path: route for route in found if isinstance(route, APIRoute) and "GET" in (route.methods or ())
    }


def as_started(value: str) -> str:
    """Return the value of a variable with what a reader would insert."""
    return INSERTED.sub(lambda found: found[2] if found[1] == "-" else "x" * 30, str(value))


@pytest.mark.parametrize("place", environments())
def test_variables_are_settings_that_have_these_values(place: str) -> None:
    variables = environments()[place]
    own = {name: value for name, value in variables.items() if name.startswith(PREFIX)}
    assert set(variables) - set(own) <= OTHER_VARIABLES
    fields = {name.removeprefix(PREFIX).lower(): as_started(value) for name, value in own.items()}
    assert set(fields) <= set(Settings.model_fields)
    assert Settings(_env_file=None, **fields).model_fields_set >= set(fields)


def test_probes_ask_paths_that_need_no_key_on_the_port_of_the_server() -> None:
    known, port = routes(), Settings(_env_file=None).port
    probed = 0
    for _, container in containers():
        ports = {each["name"]: each["containerPort"] for each in container.get("ports", [])}
        for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
            if probe in container:
                asked = container[probe]["httpGet"]
                assert ports[asked["port"]] == port
                assert any(each.dependency is public for each in known[asked["path"]].dependencies)
                probed += 1
    assert probed == 3
    docker = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    asked_path = re.search(rf"http://127\.0\.0\.1:{port}(/\w+)", docker)
    assert asked_path is not None
    assert asked_path[1] in known
    assert f"EXPOSE {port}" in docker
    assert compose()["services"]["roomfix"]["ports"] == [f"{port}:{port}"]


def test_commands_exist() -> None:
    given = [container["command"] for _, container in containers()]
    given += [each["command"] for each in own_services().values() if "command" in each]
    assert len(given) == 5
    assert all(command[0] == "roomfix" and command[1] in COMMANDS for command in given)


def test_pods_run_as_the_numeric_user_of_the_image() -> None:
    docker = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    user = re.search(r"^USER (\d+):(\d+)$", docker, re.MULTILINE)
    assert user is not None
    for pod, container in containers():
        context = pod["securityContext"]
        assert context["runAsNonRoot"]
        assert (context["runAsUser"], context["runAsGroup"]) == (int(user[1]), int(user[2]))
        assert container["securityContext"]["readOnlyRootFilesystem"]
        data = re.search(r"ROOMFIX_DATA_DIR=(\S+)", docker)
        assert data is not None
        mounts = {mount["mountPath"]: mount["name"] for mount in container["volumeMounts"]}
        assert set(mounts) == {data[1], "/tmp"}
        assert set(mounts.values()) == {volume["name"] for volume in pod["volumes"]}
        assert container["image"] == kustomization()["images"][0]["name"]


def test_kubernetes_parts_name_each_other() -> None:
    files = {path.name for path in KUBERNETES.glob("*.yaml")} - {"kustomization.yaml"}
    assert files == set(kustomization()["resources"])
    pods = {}
    for (kind, name), each in manifests().items():
        if kind == "Deployment":
            pods[name] = each["spec"]["template"]["metadata"]["labels"]
            assert each["spec"]["selector"]["matchLabels"] == pods[name]
        if kind in ("PodDisruptionBudget", "HorizontalPodAutoscaler"):
            assert ("Deployment", name) in manifests()
        if kind == "HorizontalPodAutoscaler":
            assert each["spec"]["scaleTargetRef"]["name"] == name
            assert "replicas" not in manifests()["Deployment", name]["spec"]
            assert each["spec"]["minReplicas"] >= 2
    for name, labels in pods.items():
        assert manifests()["PodDisruptionBudget", name]["spec"]["selector"]["matchLabels"] == labels
    service = manifests()["Service", "roomfix"]["spec"]
    assert service["selector"] == pods["roomfix-server"]
    served = {port["name"] for _, container in containers() for port in container.get("ports", [])}
    assert {port["targetPort"] for port in service["ports"]} == served
    generated = {each["name"] for each in kustomization()["configMapGenerator"]}
    assert all(container["envFrom"][0]["configMapRef"]["name"] in generated for _, container in containers())


def test_the_guide_lists_what_the_secret_holds() -> None:
    guide = (ROOT / "docs" / "operate.md").read_text(encoding="utf-8")
    command = re.search(r"kubectl create secret generic roomfix(.*?)```", guide, re.DOTALL)
    assert command is not None
    named = set(re.findall(r"--from-literal=([A-Z_]+)=", command[1]))
    assert named >= {"ROOMFIX_ADMIN_KEY", "ROOMFIX_DATABASE_URL"}
    assert {name for name in named if not name.startswith(PREFIX)} <= OTHER_VARIABLES
    settings = {name.removeprefix(PREFIX).lower() for name in named if name.startswith(PREFIX)}
    assert settings <= set(Settings.model_fields)


def test_services_of_compose_name_each_other() -> None:
    services, volumes = compose()["services"], set(compose()["volumes"])
    for each in services.values():
        assert set(each.get("depends_on", [])) <= set(services)
        for mount in each.get("volumes", []):
            source = mount.split(":")[0]
            assert (ROOT / source).is_file() if source.startswith(".") else source in volumes
    # What starts without a profile needs nothing that doesn't.
    assert {name for name, each in services.items() if "profiles" not in each} == {"roomfix"}
    assert {profile for each in services.values() for profile in each.get("profiles", [])} == {
        "caddy",
        "scale",
    }
    for name, each in services.items():
        for needed in each.get("depends_on", []):
            asked = services[needed].get("profiles")
            assert asked is None or set(each["profiles"]) <= set(asked), name


@pytest.mark.parametrize("path", sorted(DEPLOY.glob("caddy/*.Caddyfile")), ids=lambda path: path.name)
def test_caddy_asks_services_and_paths_that_exist(path: Path) -> None:
    text, port = path.read_text(encoding="utf-8"), Settings(_env_file=None).port
    upstreams = re.findall(r"\b([a-z0-9-]+):(\d+)\b", text)
    assert upstreams
    assert all(name in own_services() and int(number) == port for name, number in upstreams)
    assert set(re.findall(r"health_uri (\S+)", text)) <= set(routes())
    mounted = [name for name, each in compose()["services"].items()
               if any(path.name in mount for mount in each.get("volumes", []))]  # fmt: skip
    assert len(mounted) == 1
    variables = set(re.findall(r"\{\$([A-Z_]+)", text))
    assert variables <= set(compose()["services"][mounted[0]]["environment"])
