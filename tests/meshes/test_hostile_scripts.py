"""gmsh scripts of somebody else: no program, no foreign file, no end of memory or time.

Canaries lie in a folder that is watched: to open a file there is enough to be seen.
"""

from __future__ import annotations

import ctypes
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import meshes
from app.case.geometries import MeshFile
from app.case.gmsh_header import ALLOWED
from app.case.shapes import MeshOptions
from app.errors import GeometryError
from meshes import gmsh_process

SHAPE = """\
DefineConstant[ size = 1 ];
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, 1, 1, 1};
Physical Volume("box") = {1};
MeshSize { PointsOf { Volume{:}; } } = size;
"""

# What reaches files and programs; @ is the folder of the canaries.
ATTEMPTS = (
    'SystemCall "touch @/new";',
    'NonBlockingSystemCall "touch @/new";',
    'Merge "@/hook.geo";',
    "Merge '@/hook.geo';",
    'Include "@/hook.geo";',
    'MergeWithBoundingBox "@/hook.geo";',
    'Merge StrCat("@", "/hook.geo");',
    'Merge "../canaries/hook.geo";',
    'Merge "link.geo";',
    'Merge "@/shape.msh";',
    'Printf("x") > "@/new";',
    'Printf("x") >> "@/secret.txt";',
    'Save "@/new.msh";',
    'Print "@/new.msh";',
    'a() = ListFromFile("@/secret.txt");',
    'Field[9] = Structured; Field[9].FileName = "@/secret.txt"; Background Field = 9;',
    'Field[9] = ExternalProcess; Field[9].CommandLine = "cat @/secret.txt"; Background Field = 9;',
    'OnelabRun("x", "touch @/new");',
    'CreateDir "@/new";',
    'ShapeFromFile("@/secret.txt");',
    'General.ErrorFileName = "@/new"; Error("x");',
    'Solver.Executable0 = "touch @/new"; Solver.AutoMesh = 1;',
    'General.Terminal = 1; Printf("$MeshFormat");',
    "General.NumThreads = 64;",
)
# Where lexers differ: comments that gmsh seeks back into, strings that spill, macros, loops.
PLACES = (
    "{}",
    "For i In {{1:2}}\n{}\nEndFor",
    "For i In {{1:2}} /* \n{}\n*/ EndFor",
    "If (1)\n{}\nEndIf",
    "Macro Hidden\n{}\nReturn\nCall Hidden;",
    'x = "' + 1030 * "a" + '{}";',
    "// {}\n",
)


@pytest.fixture(autouse=True)
def allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ALLOWED, "1")


@pytest.fixture
def canaries(tmp_path: Path) -> Path:
    folder = tmp_path / "canaries"
    folder.mkdir()
    folder.chmod(0o777)
    (folder / "secret.txt").write_text("1 2 3\n")
    (folder / "secret.txt").chmod(0o666)
    (folder / "hook.geo").write_text(f'SystemCall "touch {folder}/new";\n')
    (folder / "shape.msh").write_text("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n")
    return folder


@contextmanager
def watched(folder: Path) -> Iterator[list[str]]:
    """Names of what is opened, made, changed or removed in a folder meanwhile."""
    libc = ctypes.CDLL(None, use_errno=True)
    file = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
    seen: list[str] = []
    opened, changed, attributes, made = 0x20, 0x2, 0x4, 0x3C0  # of sys/inotify.h
    mask = opened | changed | attributes | made
    assert libc.inotify_add_watch(file, os.fsencode(folder), mask) >= 0
    try:
        yield seen
        while True:
            try:
                events = os.read(file, 1 << 16)
            except BlockingIOError:
                return
            while events:
                length = struct.unpack_from("iIII", events)[3]
                seen.append(events[16 : 16 + length].rstrip(b"\0").decode())
                events = events[16 + length :]
    finally:
        os.close(file)


def mesh(folder: Path, text: str) -> None:
    """Mesh a script in a folder beside the canaries."""
    folder.mkdir(exist_ok=True)
    (folder / "a.geo").write_text(text)
    if not (folder / "link.geo").is_symlink():
        (folder / "link.geo").symlink_to("../canaries/hook.geo")
    geometry = MeshFile(path=folder / "a.geo")
    meshes.build(geometry, MeshOptions(size="0.5 mm"))


def laid(attempt: str, place: str, canaries: Path) -> str:
    return place.format(attempt.replace("@", str(canaries)))


@settings(
    max_examples=settings().max_examples // 5,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    tricks=st.lists(
        st.tuples(st.sampled_from(ATTEMPTS), st.sampled_from(PLACES)), min_size=1, max_size=5
    ),
    first=st.booleans(),
)
def test_scripts_reach_nothing(
    tricks: list[tuple[str, str]], first: bool, tmp_path: Path, canaries: Path
) -> None:
    text = "\n".join(laid(*trick, canaries) for trick in tricks)
    with watched(canaries) as seen:
        try:
            mesh(tmp_path / "case", text + SHAPE if first else SHAPE + text)
        except GeometryError as error:
            assert str(error)
    assert not seen
    assert {p.name for p in canaries.iterdir()} == {"secret.txt", "hook.geo", "shape.msh"}
    assert {p.name for p in (tmp_path / "case").iterdir()} == {"a.geo", "link.geo"}


def test_the_same_scripts_reach_all_that_is_not_confined(
    tmp_path: Path, canaries: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise the canaries would mean nothing."""
    free = "from app import confined as c; c.enter = lambda *a: __import__('os').chdir(a[0]); "
    monkeypatch.setattr(gmsh_process, "_SERVE", free + gmsh_process._SERVE)
    kinds = {
        "called": 'SystemCall "touch @/called";',
        "new": 'Merge "@/hook.geo";',
        "printed": 'Printf("x") > "@/printed";',
        "saved.msh": 'Save "@/saved.msh";',
        "made": 'CreateDir "@/made";',
        "shape.msh": 'Merge "@/shape.msh";',
        "secret.txt": 'a() = ListFromFile("@/secret.txt");',
    }
    with watched(canaries) as seen, suppress(GeometryError):
        mesh(tmp_path / "case", SHAPE + laid("\n".join(kinds.values()), "{}", canaries) + "\n")
    assert {*kinds} <= {*seen}


WAYS = {
    "namespaces": "c._only_this_folder = refuse; ",
    "rules": "c.separate = refuse; c.os.chroot = refuse; ",
    "none": "c.separate = c._only_this_folder = c.os.chroot = refuse; ",
}


@pytest.mark.parametrize("way", WAYS)
def test_each_way_to_confine_holds_alone(
    way: str,
    tmp_path: Path,
    canaries: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Where a machine has one of them; with none of them no program starts, and that is told."""
    blocked = (
        "from app import confined as c\ndef refuse(*a): raise PermissionError(1, 'no')\n"
        f"{WAYS[way]}\n"
    )
    monkeypatch.setattr(gmsh_process, "_SERVE", blocked + gmsh_process._SERVE)
    mesh(tmp_path / "plain", SHAPE)
    told = "limits of memory and time alone" in caplog.text
    if told and way != "none":
        pytest.skip(f"no {way} here")
    assert told == (way == "none")
    reach = {"none": ATTEMPTS[:2]}.get(way, ATTEMPTS)
    with watched(canaries) as seen, suppress(GeometryError):
        mesh(tmp_path / "case", SHAPE + "".join(laid(a, "{}\n", canaries) for a in reach))
    assert not seen


@pytest.mark.parametrize("grows", [False, True], ids=["time", "memory"])
def test_a_script_that_never_ends_is_stopped(
    grows: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = "from meshes import gmsh_process as g; g.SECONDS = 2; "
    if grows:  # of a machine with 1 GiB
        few = "import os; os.sysconf = lambda name: 1 << 15; "
    monkeypatch.setattr(gmsh_process, "_SERVE", few + gmsh_process._SERVE)
    step = "a() = {a(), a()};" if grows else "a() = {i};"
    with pytest.raises(GeometryError, match=r"file is damaged or too large|Out of memory"):
        mesh(tmp_path / "case", f"a() = {{1}};\nFor i In {{1:1000000000}}\n{step}\nEndFor\n{SHAPE}")
