"""Podman and buildah with images, containers and volumes in a folder of their own, without a registry of images.

The bases are made of Debian's packages: on a machine that reaches no registry there is no other way, and where one is
reached the fleet is built the same. As root, with the packages that `PROGRAMS` names.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import venv
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

STAND_INS = Path(__file__).parent / "stand_ins"
PROGRAMS = {
    "podman": "podman",
    "buildah": "buildah",
    "conmon": "conmon",
    "runc": "runc",
    "netavark": "netavark",
    "aardvark-dns": "aardvark-dns",
    "iptables": "iptables",
    "debootstrap": "debootstrap",
    "git": "git",
}
"""What is run, and Debian's package that has it."""
HELPERS = ("/usr/local/libexec/podman", "/usr/local/lib/podman", "/usr/libexec/podman", "/usr/lib/podman")
"""Where podman looks for programs that nobody else runs."""
BASES = {
    "docker.io/library/python:3.11.14-slim-bookworm": "python.Dockerfile",
    "docker.io/library/postgres:15.14-bookworm": "postgres.Dockerfile",
}
"""Images that Dockerfile and docker-compose.yml name, and what stands in for them."""
DEBIAN = "localhost/debian:bookworm-slim"
SETTINGS = """[containers]
default_ulimits = ["nofile=1024:1024", "nproc=1000:1000"]
[network]
network_backend = "netavark"
[engine]
runtime = "runc"
cgroup_manager = "cgroupfs"
events_logger = "file"
"""
WRAPPER = """#!/bin/sh
begin() {{ exec {program} --root {folder}/storage --runroot {folder}/run --storage-driver overlay "$@"; }}
case "$1" in
    # Podman otherwise mounts a /run of its own over what is to be written there, which Docker does not.
    run|create) command=$1; shift; begin "$command" --read-only-tmpfs=false "$@" ;;
    *) begin "$@" ;;
esac
"""


def missing_packages() -> list[str]:
    """Return Debian's packages of those programs that are not there."""
    places = os.pathsep.join([os.environ.get("PATH", os.defpath), *HELPERS])
    return [package for program, package in PROGRAMS.items() if shutil.which(program, path=places) is None]


class Containers:
    """All that podman knows, in one folder."""

    def __init__(self, folder: Path, note: Callable[[str], None]) -> None:
        """`note` is told what is done."""
        if os.geteuid() != 0:
            sys.exit("make fleet runs as root: it makes a network and file systems of its own")
        if missing := missing_packages():
            sys.exit(
                "make fleet needs programs that are not here: "
                f"`apt-get install --no-install-recommends {' '.join(missing)}` installs them"
            )
        self.folder, self._note = folder, note
        self._programs = folder / "bin"
        self._programs.mkdir(parents=True, exist_ok=True)
        for name in ("podman", "buildah"):
            wrapper = self._programs / name
            wrapper.write_text(WRAPPER.format(program=shutil.which(name), folder=folder))
            wrapper.chmod(0o755)
        (folder / "containers.conf").write_text(SETTINGS)
        self._environment = {
            **os.environ,
            "CONTAINERS_CONF": str(folder / "containers.conf"),
            "PATH": f"{self._programs}:{folder / 'compose/bin'}:{os.environ['PATH']}",
        }

    def run(
        self, *words: object, cwd: Path | None = None, environment: Mapping[str, str] | None = None, check: bool = True
    ) -> str:
        """Run a program with these settings and return what it printed; what it said beside that is kept in a log."""
        with (self.folder / "log.txt").open("a") as log:
            log.write(f"$ {' '.join(map(str, words))}\n")
            log.flush()
            ended = subprocess.run(
                [str(word) for word in words],
                stdout=subprocess.PIPE, stderr=log, text=True, check=False, cwd=cwd or self.folder,
                env={**self._environment, **(environment or {})},
            )  # fmt: skip
            log.write(ended.stdout)
        if check and ended.returncode:
            tail = (self.folder / "log.txt").read_text()[-2000:]
            raise RuntimeError(f"{' '.join(map(str, words[:4]))} … ended with {ended.returncode}:\n{tail}")
        return ended.stdout

    def podman(self, *words: object, check: bool = True) -> str:
        """Run podman."""
        return self.run(self._programs / "podman", *words, check=check)

    def has(self, image: str) -> bool:
        """Tell whether an image is there."""
        return bool(self.podman("images", "--quiet", image).strip())

    def build(self, image: str, file: Path, context: Path, *, with_pip: bool = False, **arguments: str) -> None:
        """Build an image; what has not changed is taken from the build before.

        Args:
            image: its name.
            file: the Dockerfile.
            context: what it may copy.
            with_pip: whether it installs packages, as pip on this machine does.
            arguments: of the build.
        """
        given = [f"--build-arg={name}={value}" for name, value in arguments.items()]
        self.run(
            self._programs / "buildah", "bud", "--isolation=chroot", "--network=host", "--format=docker", "--layers",
            *(self._pip_mounts() if with_pip else ()), *given, f"--tag={image}", f"--file={file}", context,
        )  # fmt: skip

    def make_bases(self) -> None:
        """Make what stands in for images of a registry; what has not changed is there."""
        if not self.has(DEBIAN):
            self._note("Debian, from its packages")
            tree = self.folder / "debian"
            shutil.rmtree(tree, ignore_errors=True)
            self.run("debootstrap", "--variant=minbase", "--include=ca-certificates", "bookworm", tree)
            for left in ("var/lib/apt/lists", "var/cache/apt"):
                shutil.rmtree(tree / left)
                (tree / left).mkdir()
            self.run("tar", "--create", f"--file={self.folder / 'debian.tar'}", f"--directory={tree}", ".")
            self.podman("import", self.folder / "debian.tar", DEBIAN)
            shutil.rmtree(tree)
            (self.folder / "debian.tar").unlink()
        for image, file in BASES.items():
            self._note(f"what stands in for {image}")
            self.build(image, STAND_INS / file, STAND_INS)

    def composer(self) -> str:
        """Return podman-compose, which is installed in an environment of its own: it is no package of ours."""
        place = self.folder / "compose"
        if not (place / "bin/podman-compose").exists():
            venv.create(place, with_pip=True)
            self.run(place / "bin/pip", "install", "--quiet", "podman-compose")
        return str(place / "bin/podman-compose")

    def _pip_mounts(self) -> Sequence[str]:
        """Have pip in a build use the indexes and certificates that it uses on this machine."""
        told = self.run(sys.executable, "-m", "pip", "config", "list")
        settings = dict(re.findall(r"^(?:global|:env:)\.([a-z-]+)='(.*)'$", told, re.MULTILINE))
        lines = [f"{name} = {value}" for name, value in settings.items()]
        (self.folder / "pip.conf").write_text("\n".join(["[global]", *lines, ""]))
        places = {Path("/etc/ssl/certs")}
        for word in re.split(r"[\s,]+", " ".join(settings.values())):
            place = Path(word.removeprefix("file://"))
            if place.is_absolute() and place.exists():
                # An index of files leads to their folder beside it.
                places.add(place if place.parent == Path("/") else place.parent)
        return [f"--volume={place}:{place}:ro" for place in sorted(places)] + [
            f"--volume={self.folder / 'pip.conf'}:/etc/pip.conf:ro"
        ]
