"""The image of the Dockerfile, built without a container engine, and a sweep run in it.

The steps of the Dockerfile are carried out as they stand, in a Debian 13 that is written to by
nobody else: a layer over the one that the tests run in. Only the packages are there already, which
is checked against packages.txt.
"""

from __future__ import annotations

import fnmatch
import json
import os
import re
import shlex
import shutil
import stat
import subprocess
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import pytest

from tests import support

pytestmark = pytest.mark.slow

# What a user gives to `docker run -v "$PWD:/work" mantle`.
COMMAND = (
    *("sweep", "sweeps/friction_cylinders.yaml", "-o", "out", "--set", "ranks=2"),
    *("--set", "mesh.size=4 mm", "--set", "mesh.far_size=6 mm"),
)
PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"  # as engines set it
# A process of the image: its own mounts and processes, which end with it.
INSIDE = """\
mount --make-rprivate "$(findmnt -n -o TARGET --target "$PWD")" || exit 99
mount -t overlay overlay -o "lowerdir=$TREE,upperdir=upper,workdir=inner" root || exit 99
mount -t proc proc root/proc || exit 99
mount --rbind /dev root/dev && mount --rbind /sys root/sys || exit 99
[ ! -d root/work ] || mount --bind work root/work || exit 99
exec chroot "$@"
"""
NAMESPACES = ("unshare", "-m", "-p", "-f", "--kill-child", "--propagation", "unchanged")
NO_MOUNTS = 99


@dataclass
class Image:
    """What a Dockerfile has come to.

    Attributes:
        folder: Holds its layer and the folder that is shown to it as /work.
        environ: Its environment.
        user: Who runs in it.
        place: Where.
        entry: What runs in it.
    """

    folder: Path
    environ: dict[str, str] = field(default_factory=lambda: {"PATH": PATH})
    user: str = "root"
    place: str = "/"
    entry: tuple[str, ...] = ()

    @property
    def layer(self) -> Path:
        """What the image has beyond the Debian below it."""
        return self.folder / "upper"

    def run(
        self, *command: str, stdin: IO[bytes] | int = subprocess.DEVNULL
    ) -> subprocess.CompletedProcess[str]:
        """Run a command in it."""
        home = "/root" if self.user == "root" else f"/home/{self.user}"
        words = [f"{k}={v}" for k, v in {"HOME": home, **self.environ}.items()]
        return subprocess.run(
            [
                *(*NAMESPACES, "sh", "-c", INSIDE, "sh", f"--userspec={self.user}:{self.user}"),
                *("root", "/usr/bin/env", "-i", f"--chdir={self.place}", *words, *command),
            ],
            cwd=self.folder,
            env=os.environ | {"TREE": os.environ.get("MANTLE_TREE", "/")},
            stdin=stdin,
            capture_output=True,
            text=True,
        )

    def carry_out(self, instruction: str, value: str) -> None:
        """A step of the Dockerfile."""
        match instruction:
            case "FROM":
                assert value == "debian:trixie-slim"
                # It has no /work, whatever is below has: this is how a layer says so.
                os.mknod(self.layer / "work", stat.S_IFCHR, os.makedev(0, 0))
            case "COPY":
                source, target = value.split()
                packed = self.folder / "context.tar"
                context(source, packed)
                folder = target if source == "." else str(Path(target).parent)
                unpack = f"mkdir -p {folder} && tar -x --no-same-owner -C {folder}"
                with packed.open("rb") as file:
                    done = self.run("/bin/sh", "-c", unpack, stdin=file)
                assert done.returncode == 0, done.stderr
            case "RUN" if "apt-get" in value:
                assert "/tmp/packages.txt" in value
                packages = re.sub(r"#.*", "", (support.ROOT / "packages.txt").read_text()).split()
                done = self.run("dpkg-query", "-W", "-f=${Status}\n", *packages)
                assert done.returncode == 0, done.stderr
                assert set(done.stdout.splitlines()) == {"install ok installed"}
            case "RUN":
                done = self.run("/bin/sh", "-c", value)
                assert done.returncode == 0, f"{value}\n{done.stdout}\n{done.stderr}"
            case "ENV":
                self.environ |= dict(word.split("=", 1) for word in shlex.split(value))
            case "USER":
                self.user = value
            case "WORKDIR":
                self.place = value
            case "ENTRYPOINT":
                self.entry = tuple(json.loads(value))
            case _:
                raise AssertionError(f"{instruction} is not known here")


def instructions() -> Iterator[tuple[str, str]]:
    """The steps of the Dockerfile."""
    text = re.sub(r"^#.*\n", "", (support.ROOT / "Dockerfile").read_text(), flags=re.M)
    for line in text.replace("\\\n", " ").splitlines():
        if line.strip():
            instruction, _, value = line.partition(" ")
            yield instruction, value.strip()


def context(source: str, path: Path) -> None:
    """Pack what is copied out of the checkout, less what .dockerignore keeps out."""
    lines = (support.ROOT / ".dockerignore").read_text().split()
    kept = [line.removeprefix("!") for line in lines if line.startswith("!")]
    ignored = [line.removeprefix("**/") for line in lines if line.startswith("**/")]
    assert lines[0] == "*" and len(lines) == 1 + len(kept) + len(ignored)

    def wanted(info: tarfile.TarInfo) -> tarfile.TarInfo | None:
        name = Path(info.name).name
        return None if any(fnmatch.fnmatch(name, pattern) for pattern in ignored) else info

    with tarfile.open(path, "w") as archive:
        for name in kept if source == "." else [source]:
            assert name in kept
            archive.add(support.ROOT / name, name, filter=wanted)


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Image:
    made = Image(tmp_path_factory.mktemp("image"))
    for name in ("upper", "inner", "root", "work"):
        (made.folder / name).mkdir()
    if os.geteuid() != 0 or made.run("true").returncode in (1, NO_MOUNTS):
        pytest.skip("this user may not lay one file system over another")
    for instruction, value in instructions():
        made.carry_out(instruction, value)
    return made


def test_a_sweep_runs_in_the_image(image: Image) -> None:
    """As its user, in a folder of the caller's, without compiling anything."""
    work = image.folder / "work"
    (work / "sweeps").mkdir()
    for name in ("cylinders.yaml", "sweeps/friction_cylinders.yaml"):
        shutil.copy(support.CONFIGS / name, work / name)
    done = image.run("id", "-u")
    user = int(done.stdout)
    assert user != 0
    os.chown(work, user, user)

    def compiled() -> set[str]:
        return {p.name for p in (image.layer / "var/cache/mantle/fenics").glob("*.so")}

    before = compiled()
    done = image.run(*image.entry, *COMMAND)
    assert done.returncode == 0, done.stdout + done.stderr
    assert before and compiled() == before
    cases: list[dict[str, Any]] = json.loads((work / "out/sweep.json").read_text())["cases"]
    assert len(cases) == 16
    for case in cases:
        folder = work / "out" / case["folder"]
        assert case["status"] == "converged" and (folder / "DONE").stat().st_uid == user
        # It is the image's mantle that ran, not the checkout.
        record = json.loads((folder / "provenance.json").read_text())
        assert not any(str(support.ROOT) in word for word in record["command"])
    assert not (image.layer / "opt/mantle").exists()
