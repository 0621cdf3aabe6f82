"""The image of the Dockerfile, built by buildah without an engine, and runs in it.

Its base comes from the archive of the Debian of the tests. Nothing is pulled.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests import support
from tests.cases.misleading import mislead

pytestmark = pytest.mark.slow
SPACE = 15e9  # bytes: the layers of the image, each a whole tree
# What a user gives to `docker run -v "$PWD:/work" mantle`.
STANCE = (
    *("run", "stance.yaml", "-n", "2", "-o", "stance", "--set", "output.error=false"),
    *("--set", "mesh.size=8 mm", "--set", "mesh.far_size=16 mm", "--set", "mesh.around=8"),
)
SWEEP = (
    *("sweep", "sweeps/friction_cylinders.yaml", "-o", "sweep", "--set", "ranks=2"),
    *("--set", "mesh.size=4 mm", "--set", "mesh.far_size=6 mm"),
)


@dataclass
class Image:
    """An image, and a container with it.

    Attributes:
        folder: Holds the storage of buildah, and the folder that is shown to it as /work.
    """

    folder: Path

    @property
    def work(self) -> Path:
        return self.folder / "work"

    def buildah(self, command: str, *arguments: str | Path) -> str:
        where = ["--root", self.folder / "storage", "--runroot", self.folder / "run"]
        done = subprocess.run(
            ["buildah", *where, "--storage-driver", "vfs", command, *arguments],
            env={k: v for k, v in os.environ.items() if k != "TMPDIR"}
            | {"TMPDIR": str(self.folder)},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def run(self, *command: str, user: str = "mantle") -> str:
        shown = f"{self.work}:/work"
        options = ["--isolation=chroot", "--user", user, "--volume", shown, "--workingdir", "/work"]
        return self.buildah("run", *options, "case", "--", *command)

    def compiled(self, cache: str) -> set[str]:
        return set(self.run("sh", "-c", f"cd {cache}/fenics && ls *.so").split())


def base(image: Image) -> None:
    tar = image.folder / "base.tar"
    done = subprocess.run(
        ["mmdebstrap", "--variant=minbase", "--mode=root", "trixie", tar, "/etc/apt/sources.list"],
        env=os.environ | {"TMPDIR": str(image.folder)},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        pytest.skip(f"no archive to make an image of: {done.stderr.splitlines()[-1]}")
    image.buildah("from", "--name", "base", "scratch")
    image.buildah("add", "base", tar, "/")
    image.buildah("commit", "--rm", "base", "localhost/base")


def limits() -> list[str]:
    """Limits of this process for processes in the image, because buildah asks for more."""
    known = {"nproc": resource.RLIMIT_NPROC, "nofile": resource.RLIMIT_NOFILE}
    hard = {name: resource.getrlimit(limit)[1] for name, limit in known.items()}
    return [f"--ulimit={name}={n}:{n}" for name, n in hard.items() if n != resource.RLIM_INFINITY]


@pytest.fixture(scope="module")
def image() -> Iterator[Image]:
    # Not in /tmp, which may be in memory.
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    if os.geteuid() != 0 or not shutil.which("buildah") or not shutil.which("mmdebstrap"):
        pytest.skip("only root, with buildah and mmdebstrap, can build an image")
    if shutil.disk_usage(cache).free < SPACE:
        pytest.skip(f"an image takes {SPACE / 1e9:.0f} GB in {cache} while it is built")
    made = Image(Path(tempfile.mkdtemp(prefix="mantle-image-", dir=cache)))
    try:
        base(made)
        options = ["--isolation=chroot", "--pull-never", "--network=host", "--from=localhost/base"]
        made.buildah("bud", *limits(), *options, "--tag", "mantle", support.ROOT)
        made.buildah("from", *limits(), "--pull-never", "--name", "case", "localhost/mantle")
        made.work.mkdir()
        yield made
    finally:
        shutil.rmtree(made.folder)


def test_image_runs_cases_and_sweeps_without_a_compiler(image: Image) -> None:
    """The user of the image runs them in a folder of the caller."""
    (image.work / "sweeps").mkdir()
    for name in ("stance.yaml", "cylinders.yaml", "sweeps/friction_cylinders.yaml"):
        shutil.copy(support.CONFIGS / name, image.work / name)
    user = int(image.run("id", "-u"))
    assert user != 0
    os.chown(image.work, user, user)
    config = json.loads(image.buildah("inspect", "case"))["OCIv1"]["config"]
    assert config["User"] == "mantle" and config["Entrypoint"] == ["mantle"]
    brought = image.compiled("/var/cache/mantle")
    others = "find /var/cache/mantle ! -user root -o ! -type l -perm /022"
    assert brought and not image.run("sh", "-c", others)
    image.run(*config["Entrypoint"], *STANCE)
    image.run(*config["Entrypoint"], *SWEEP)
    assert image.compiled("~mantle/.cache") <= brought
    cases: list[dict[str, Any]] = json.loads((image.work / "sweep/sweep.json").read_text())["cases"]
    assert len(cases) == 16 and all(case["status"] == "converged" for case in cases)
    folders = [image.work / "sweep" / case["folder"] for case in cases]
    for folder in (image.work / "stance", *folders):
        assert (folder / "DONE").stat().st_uid == user
        record = json.loads((folder / "provenance.json").read_text())
        assert record["ranks"] == 2


def test_image_ignores_a_hostile_folder(image: Image) -> None:
    """A run on one rank and a sweep on two ignore the files."""
    folder = image.work / "hostile"
    folder.mkdir()
    mislead(folder)
    user = int(image.run("id", "-u"))
    for path in (image.work, folder, *folder.rglob("*")):
        os.chown(path, user, user)
    image.run(
        "sh", "-c", "cd hostile && mantle run blocks.yaml -o one && mantle sweep sweep.yaml -o many"
    )
    assert (folder / "one" / "DONE").exists() and list(folder.glob("many/runs/*/DONE"))
    assert not list(folder.rglob("petsc.txt"))
