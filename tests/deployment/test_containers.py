"""The container files, checked without building them: structure, names that must agree, and what a hardened one has."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
import yaml

from app.access.access_control import HEALTH as HEALTH_PATHS
from app.cli.main import _parser
from app.settings import ServiceSettings
from tests.deployment.containers import BASES, STAND_INS
from workers.processor import FEATURES_VARIABLE, NAME_VARIABLE

ROOT = Path(__file__).resolve().parents[2]
COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
SERVICES: dict[str, dict[str, Any]] = COMPOSE["services"]
OURS = {name: service for name, service in SERVICES.items() if "build" in service}
DURATION = re.compile(r"(\d+(ms|s|m|h))+")
SHAPES: dict[str, type | tuple[type, ...]] = {
    "build": (str, dict), "image": str, "command": (str, list), "environment": (dict, list), "depends_on": (dict, list),
    "user": str, "read_only": bool, "tmpfs": (str, list), "cap_drop": list, "security_opt": list, "restart": str,
    "stop_grace_period": str, "ports": list, "volumes": list, "healthcheck": dict, "scale": int, "shm_size": str,
    "mem_limit": str, "pids_limit": int, "cpu_shares": int,
}  # fmt: skip
"""The members of a service (Compose Specification) that are used here, and what they may be."""
HEALTH = {"test": list, "interval": str, "timeout": str, "retries": int, "start_period": str}


def instructions() -> list[tuple[str, str]]:
    """The Dockerfile's instructions with their arguments."""
    text = re.sub(r"^\s*#.*\n", "", (ROOT / "Dockerfile").read_text(), flags=re.MULTILINE)
    lines = re.sub(r"\\\n\s*", "", text).splitlines()
    return [(word, rest.strip()) for word, _, rest in (line.partition(" ") for line in lines if line.strip())]


DOCKERFILE = instructions()
FINAL = DOCKERFILE[max(number for number, (word, _) in enumerate(DOCKERFILE) if word == "FROM") :]
"""The stage that becomes the image."""


def arguments(instruction: str, stage: list[tuple[str, str]] = DOCKERFILE) -> list[str]:
    return [rest for word, rest in stage if word == instruction]


def environment_of_the_image() -> dict[str, str]:
    return dict(pair.split("=", 1) for line in arguments("ENV", FINAL) for pair in shlex.split(line))


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_has_members_of_the_specification_only_each_of_its_type(name: str) -> None:
    service = SERVICES[name]
    assert {member for member in service if not isinstance(service[member], SHAPES.get(member, ()))} == set()
    health = service["healthcheck"]
    assert {member for member in health if not isinstance(health[member], HEALTH.get(member, ()))} == set()
    assert health["test"][0] in ("CMD", "CMD-SHELL", "NONE")
    spans = [service["stop_grace_period"], *(health[each] for each in ("interval", "timeout", "start_period") if each in health)]  # fmt: skip  # noqa: E501
    assert all(DURATION.fullmatch(span) for span in spans)
    assert set(COMPOSE) <= {"services", "volumes", "x-liftwright"}


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_is_hardened_restarted_and_watched(name: str) -> None:
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["user"] not in ("root", "0")
    assert service["cap_drop"] == ["ALL"]
    assert "no-new-privileges:true" in service["security_opt"]
    assert service["restart"] == "unless-stopped"
    assert service["healthcheck"]["test"][0] != "NONE"


@pytest.mark.parametrize("name", SERVICES)
def test_what_a_service_names_exists(name: str) -> None:
    service = SERVICES[name]
    assert {volume.partition(":")[0] for volume in service.get("volumes", ())} <= set(COMPOSE["volumes"])
    # No condition: podman cannot wait for one, so that whoever needs another waits by itself.
    assert isinstance(service.get("depends_on", []), list)
    assert {*service.get("depends_on", [])} <= set(SERVICES)
    _, _, tag = service["image"].partition(":")
    assert re.fullmatch(r"\d+\.\d+.*", tag), "an image has a version"
    assert all(port.startswith("127.0.0.1:") for port in service.get("ports", ())), "published to this machine only"


@pytest.mark.parametrize("name", SERVICES)
def test_what_a_service_may_take_is_bounded(name: str) -> None:
    """One that goes wrong is ended by the kernel, and leaves the others alone."""
    service = SERVICES[name]
    memory = re.fullmatch(r"(\d+)g", service["mem_limit"])
    assert memory is not None
    assert 0 < service["pids_limit"] < 1000, "a container may be let start no more"
    if name == "worker":
        solver = ServiceSettings.model_fields["solver_memory_mb"].default
        assert int(memory[1]) * 1024 > solver + 1024, "the solver meets its own limit first, and the job says so"
        assert service["environment"]["LIFTWRIGHT_STUDY_SLOTS"] == "1", "by default one a core"


def test_workers_stand_back_behind_all_that_answers() -> None:
    usual = 1024
    weights = {name: service.get("cpu_shares", usual) for name, service in SERVICES.items()}
    workers = weights.pop("worker") * SERVICES["worker"]["scale"]
    assert workers < min(weights.values())


def test_workers_are_several_by_a_member_that_every_program_knows() -> None:
    assert SERVICES["worker"]["scale"] >= 2
    assert not any("deploy" in service for service in SERVICES.values())


def test_api_and_workers_are_one_image_on_one_database() -> None:
    assert set(OURS) == {"api", "worker"}
    assert len({service["image"] for service in OURS.values()}) == 1
    urls = {service["environment"]["LIFTWRIGHT_DATABASE_URL"] for service in OURS.values()}
    assert len(urls) == 1
    assert "@postgres:5432/" in urls.pop()
    assert "postgres" in SERVICES


def test_no_password_stands_in_the_file_nor_in_an_address_where_percent_signs_would_mean_something() -> None:
    for service in SERVICES.values():
        passwords = {name: value for name, value in service["environment"].items() if "PASSWORD" in name}
        assert len(passwords) == 1
        assert set(passwords.values()) == {"${POSTGRES_PASSWORD:?set POSTGRES_PASSWORD}"}
    for service in OURS.values():
        assert "PGPASSWORD" in service["environment"]
        assert urlsplit(service["environment"]["LIFTWRIGHT_DATABASE_URL"]).password is None


def test_the_api_answers_to_its_own_names_only_unless_others_are_set() -> None:
    api = OURS["api"]
    hosts = api["environment"]["LIFTWRIGHT_ALLOWED_HOSTS"]
    default = re.fullmatch(r"\$\{LIFTWRIGHT_ALLOWED_HOSTS:-(.+)\}", hosts)
    assert default is not None
    settings = ServiceSettings.model_validate({"host": "0.0.0.0", "allowed_hosts": json.loads(default[1])})
    (published,) = (port.partition(":")[0] for port in api["ports"])
    assert {*settings.allowed_hosts} == {"localhost", published, "api"}
    assert "api" in SERVICES, "by this name other containers call it"
    asked = re.search(r"http://127\.0\.0\.1:8040(/\w+)", " ".join(api["healthcheck"]["test"]))
    assert asked is not None
    assert asked[1] in HEALTH_PATHS, "whatever names are set"


@pytest.mark.parametrize("name", OURS)
def test_variables_are_settings_and_commands_are_ours(name: str) -> None:
    known = {f"LIFTWRIGHT_{field.upper()}" for field in ServiceSettings.model_fields}
    # The last is libpq's.
    assert set(OURS[name]["environment"]) <= known | {"PGPASSWORD"}
    program, *words = OURS[name]["command"]
    assert program == "liftwright"
    assert _parser().parse_args(words).command == words[0]


def test_the_image_is_built_as_linters_ask() -> None:
    words = [word for word, _ in DOCKERFILE]
    known = {"FROM", "ARG", "ENV", "WORKDIR", "COPY", "RUN", "USER", "VOLUME", "EXPOSE", "STOPSIGNAL", "HEALTHCHECK"}
    assert set(words) <= known | {"CMD"}
    before = DOCKERFILE[: words.index("FROM")]
    assert [word for word, _ in before] == ["ARG"]
    name, _, base = before[0][1].partition("=")
    assert name == "BASE"
    assert [words.count(once) for once in ("CMD", "HEALTHCHECK")] == [1, 1]
    bases = {line.partition(" ")[0] for line in arguments("FROM")}
    assert len(bases) == 1, "kernels and wheels are made for what they run on"
    assert bases == {"${BASE}"}
    assert re.fullmatch(r"python:3\.11\.\d+-slim-\w+", base), "a version, and not the latest"
    assert all(path.startswith("/") for path in arguments("WORKDIR"))
    runs = " && ".join(arguments("RUN"))
    assert not re.search(r"(?<!\S)(sudo|apt|curl|wget|cd)(?!\S)", runs)
    assert runs.count("pip install") == runs.count("pip install --no-cache-dir --constraint")
    assert isinstance(json.loads(arguments("CMD")[0]), list)
    assert isinstance(json.loads(arguments("HEALTHCHECK")[0].partition(" CMD ")[2]), list)
    assert not re.search(r"(?i)password|secret|token", " ".join(arguments("ENV") + arguments("ARG")))


def test_system_libraries_are_installed_before_packages_need_them_and_leave_no_lists_behind() -> None:
    """Slim images lack OpenMP's library: pinocchio's wheel is linked with it, and does not bring it."""
    for line in arguments("RUN"):
        if "apt-get" in line:
            update, install, clean = (part.strip() for part in line.split("&&")[:3])
            assert update == "apt-get update"
            assert install.startswith("apt-get install --no-install-recommends --yes ")
            assert clean == "rm -rf /var/lib/apt/lists/* /var/cache/apt/*"
    runs = arguments("RUN", FINAL)
    (system,) = [number for number, line in enumerate(runs) if "apt-get" in line]
    assert "libgomp1" in runs[system].split("&&")[1].split()
    assert system < runs.index("liftwright warmup")


def test_the_image_does_not_run_as_root_and_its_user_is_that_of_compose() -> None:
    after = [word for word, _ in DOCKERFILE][::-1]
    assert after.index("USER") > after.index("CMD")
    (user,) = arguments("USER")
    (made,) = re.findall(rf"useradd .*--uid (\d+) {user}\b", " ".join(arguments("RUN")))
    assert {service["user"] for service in OURS.values()} == {made}


def test_what_is_copied_exists_and_is_all_that_is_packaged() -> None:
    copied = [
        source for line in arguments("COPY") if not line.startswith("--from=") for source in shlex.split(line)[:-1]
    ]
    assert all((ROOT / source).exists() for source in copied)
    packages = set(
        tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]["find"]["include"]
    )
    assert {each.rstrip("*.") for each in packages} | {"pyproject.toml", "constraints.txt"} <= set(copied)
    let_in = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert let_in == set(copied)


def test_packages_are_in_the_image_once_and_kernels_are_compiled_from_there_by_who_runs_them() -> None:
    words = [word for word, _ in FINAL]
    assert not any(re.search(r"\b(planners|workers|app)\b", line) for line in arguments("COPY", FINAL))
    warmup = next(number for number, (_, rest) in enumerate(FINAL) if rest == "liftwright warmup")
    assert words.index("USER") < warmup < words.index("VOLUME")


def test_kernels_are_compiled_for_the_processor_that_a_build_names_and_looked_for_by_that_name() -> None:
    warmup = FINAL.index(("RUN", "liftwright warmup"))
    for variable in (NAME_VARIABLE, FEATURES_VARIABLE):
        assert FINAL.index(("ARG", f'{variable}=""')) < warmup
        assert environment_of_the_image()[variable] == f"${{{variable}}}"
    told = [number for number, (word, rest) in enumerate(FINAL) if word == "ENV" and NAME_VARIABLE in rest]
    assert max(told) < warmup


@pytest.mark.parametrize("name", OURS)
def test_what_is_written_while_it_runs_is_on_volumes_or_in_memory(name: str) -> None:
    """The compiler refuses to import kernels whose cache it cannot write to."""
    environment = environment_of_the_image()
    volumes = " ".join(arguments("VOLUME", FINAL)).split()
    mounted = [volume.partition(":")[2] for volume in OURS[name]["volumes"]] + OURS[name]["tmpfs"]
    assert environment["NUMBA_CACHE_DIR"] in volumes
    assert environment["LIFTWRIGHT_DATA_DIR"] in {*volumes, *mounted}


def test_the_command_of_the_image_is_ours() -> None:
    program, *words = json.loads(arguments("CMD")[0])
    assert program == "liftwright"
    assert _parser().parse_args(words).command == "serve"


def test_what_stands_in_for_a_base_is_named_as_where_it_is_asked_for() -> None:
    asked = {line.partition("=")[2] for line in arguments("ARG") if line.startswith("BASE=")}
    asked |= {service["image"] for service in SERVICES.values() if "build" not in service}
    assert {f"docker.io/library/{image}" for image in asked} == set(BASES)
    assert all((STAND_INS / file).is_file() for file in BASES.values())
