"""Damaged mesh files, read one after another: ``fuzz_meshes.py SEED FIRST LAST FOLDER``.

Each is a good file of two blocks (formats 2.2 and 4.1, as text and binary) that lacks its end or
parts, or has other numbers or garbage in it. Reading has to end in time, with a mesh or with an
error that the command line reports. Other outcomes are printed, a line of JSON each.
"""

from __future__ import annotations

import os
import random
import resource
import signal
import sys
import traceback
from pathlib import Path
from typing import Any

import meshes
from app.case.case import load_case
from app.foundation.errors import GeometryError, InputError
from meshes.gmsh_session import session
from tests.robustness.fuzz import search

MEMORY = 4 << 30
SECONDS = 20
FORMATS = ((2.2, 0), (2.2, 1), (4.1, 0), (4.1, 1))
CASE = """\
geometry: {kind: file, path: mutant.msh, interfaces: {a_b: [a, b]}}
mesh: {size: 1 mm}
regions:
  a: {youngs_modulus: 1 GPa, poisson_ratio: 0.3, tissue: other}
  b: {youngs_modulus: 1 GPa, poisson_ratio: 0, tissue: other}
supports: {base: {kind: fixed, boundary: bottom}}
"""
WORDS = (
    *"0 -1 1 2 3 99 nan inf -inf 1e308 1e-320 4294967296 1e5 x $Nodes 1000000000".split(),
    *("-9223372036854775808", "18446744073709551615", "", '"a"', "\0", "9" * 400, "4 4 4 4"),
)


def good(folder: Path) -> list[bytes]:
    text = """
    SetFactory("OpenCASCADE");
    Box(1) = {0, 0, 0, 1, 1, 1}; Box(2) = {0, 0, 1, 1, 1, 1}; Coherence;
    Physical Volume("a") = {1}; Physical Volume("b") = {2};
    Physical Surface("bottom") = Surface In BoundingBox {-1, -1, -0.1, 2, 2, 0.1};
    """
    (folder / "good.geo").write_text(text)
    contents = []
    with session("good") as gmsh:
        gmsh.merge(str(folder / "good.geo"))
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.7)
        gmsh.model.mesh.generate(3)
        for order in (1, 2):
            gmsh.model.mesh.setOrder(order)
            for version, binary in FORMATS:
                gmsh.option.setNumber("Mesh.MshFileVersion", version)
                gmsh.option.setNumber("Mesh.Binary", binary)
                gmsh.write(str(folder / "good.msh"))
                contents.append((folder / "good.msh").read_bytes())
    return contents


def damaged(rng: random.Random, raw: bytes) -> bytes:
    """A file with a defect."""
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        at = rng.randint(0, len(raw))
        lines = raw.split(b"\n")
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        words = lines[i].split(b" ")
        k = rng.randrange(len(words))
        match rng.randrange(10):
            case 0:
                raw = raw[:at]
            case 1:
                raw = raw[:at] + rng.randbytes(rng.randint(1, 20)) + raw[at + rng.randint(0, 20) :]
            case 2:
                filler = rng.choice((b"\xff", b"\0", b"\x80")) * rng.choice((1, 4, 8))
                raw = raw[:at] + filler + raw[at + 8 :]
            case 3:
                raw = b"\n".join(lines[:i] + lines[j:])
            case 4:
                raw = b"\n".join([*lines[:i], lines[j], *lines[i:]])
            case 5:
                raw = raw[: rng.choice((0, 12, 20, 40))]
            case _:
                # Mostly in the lines with counts, which are short.
                short = [n for n, line in enumerate(lines) if len(line.split(b" ")) <= 4]
                i = rng.choice(short) if rng.random() < 0.6 and short else i
                words = lines[i].split(b" ")
                words[min(k, len(words) - 1)] = rng.choice(WORDS).encode()
                raw = b"\n".join([*lines[:i], b" ".join(words), *lines[i + 1 :]])
    return raw


def read(path: Path) -> str:
    """Mesh a case with a damaged file; return the fault of the outcome."""
    try:
        case = load_case(path).config
        meshes.build(case.geometry, case.mesh, None)
    except (InputError, GeometryError) as error:
        return "" if str(error).strip() else "says nothing"
    except BaseException:
        return traceback.format_exc()
    return ""


def attempt(path: Path) -> str:
    """The same in a separate process, which may crash."""
    out, into = os.pipe()
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        os.write(into, read(path).encode()[:60_000])
        os._exit(0)
    os.close(into)
    with os.fdopen(out) as pipe:
        message = pipe.read()
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return (
        message
        if status == 0
        else f"ends by {signal.Signals(-status).name if status < 0 else status}"
    )


def main(seed: str, first: int, last: int, folder: Path) -> None:
    files = good(folder)
    case, mutant = folder / "case.yaml", folder / "mutant.msh"
    case.write_text(CASE)
    for raw in files:
        mutant.write_bytes(raw)
        message = read(case)
        assert not message, message

    def one(i: int) -> dict[str, Any]:
        rng = random.Random(f"{seed} {i}")
        which = rng.randrange(len(files))
        mutant.write_bytes(damaged(rng, files[which]))
        failure = attempt(case)
        if failure:
            (folder / f"found-{i}.msh").write_bytes(mutant.read_bytes())
        return {"file": which, "what": failure} if failure else {}

    search(range(first, last), one)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
