"""Checkpoints that somebody else has made, with a valid digest: refused or passed over."""

from __future__ import annotations

import copy
import hashlib
import json
import os
import random
import resource
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mpi4py import MPI  # before h5py, which may be built for MPI

import h5py
import numpy as np
import pytest

from app.cli import main
from app.simulation import checkpoint_file
from app.simulation.checkpoint_file import BLOCK, WORD, DamagedError, read
from app.system.folders import saved
from tests import restarted, support

FIELDS = ("--set", "output.fields=false")
SECRET = "told to nobody"
Told = dict[str, Any]


def sealed(path: Path, image: bytes) -> Path:
    """A checkpoint of some bytes, with their digest."""
    path.write_bytes(hashlib.sha256(image).hexdigest().encode().ljust(BLOCK) + image)
    return path


def told(path: Path) -> tuple[Told, bytes]:
    """The text of a checkpoint, and its arrays."""
    image = path.read_bytes()[BLOCK:]
    begin = WORD + int.from_bytes(image[:WORD], "little")
    return json.loads(image[WORD:begin]), image[begin:]


def forged(path: Path, text: Told | str, arrays: bytes) -> Path:
    """A checkpoint of a text and arrays, with a valid digest."""
    content = (text if isinstance(text, str) else json.dumps(text)).encode()
    content = content.ljust(-(-len(content) // WORD) * WORD)
    return sealed(path, len(content).to_bytes(WORD, "little") + content + arrays)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a case and, in ``out``, a run with checkpoints after its last two steps."""
    folder = tmp_path_factory.mktemp("forged")
    (folder / "case.yaml").write_text(restarted.RUBBING)
    command = ["run", str(folder / "case.yaml"), "-o", str(folder / "out"), *FIELDS]
    assert main([*command, "--set", "output.checkpoint.steps=1"]) == 0
    (folder / "out" / "DONE").unlink()
    return folder


@pytest.fixture
def out(run: Path, tmp_path: Path) -> Path:
    """A copy of the run directory."""
    return Path(shutil.copytree(run / "out", tmp_path / "out"))


def restart(run: Path, out: Path, wanted: str = "auto") -> int:
    return main(["run", str(run / "case.yaml"), "-o", str(out), *FIELDS, "--restart", wanted])


# ------------------------------------------------------------------------- files within files


def hdf5(path: Path, secret: Path) -> None:
    """A file whose rows are the bytes of another file, by the means of HDF5."""
    with h5py.File(path, "w") as file:
        n = secret.stat().st_size
        file.create_dataset("rows/0", (n,), np.uint8, external=[(str(secret), 0, n)])
        file["state"] = np.frombuffer(b"[{}, {}]", dtype=np.uint8)
        file["keys"] = h5py.ExternalLink(str(secret), "/")


def test_nothing_but_the_file_itself_is_read(run: Path, out: Path, tmp_path: Path) -> None:
    secret, image = tmp_path / "secret", tmp_path / "image"
    secret.write_text(SECRET)
    hdf5(image, secret)
    with h5py.File(image) as file:
        assert bytes(file["rows/0"][:]) == SECRET.encode()
    newest, before = saved(out)
    sealed(newest, image.read_bytes())
    with pytest.raises(DamagedError, match="another format"):
        read(newest)
    assert restart(run, out) == 0
    restarted.assert_same(run / "out", out)
    assert not before.exists() or read(before)


def test_a_size_that_is_announced_is_not_taken(out: Path) -> None:
    """Nothing is allocated: neither for rows, nor for a file that is all holes."""
    newest, before = saved(out)
    text, arrays = told(newest)
    (k, v), peak = text["rows"][0], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for n in (10**12, 2**63, 10**30, -1, 0.5, True):
        text["arrays"][k][1] = [n]
        text["arrays"][v][1] = [n, 3]
        with pytest.raises(DamagedError):
            read(forged(newest, text, arrays))
    os.truncate(before, 1 << 43)
    with pytest.raises(DamagedError, match="more than this machine's memory"):
        read(before)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < peak + 100_000  # kB


def test_what_is_no_file_is_not_waited_for(out: Path) -> None:
    newest, _ = saved(out)
    newest.unlink()
    os.mkfifo(newest)
    with pytest.raises(DamagedError, match="not a file"):
        read(newest)


# --------------------------------------------------------------------------------- structures


def places(tree: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The ways to all values of a tree."""
    yield way
    lists = enumerate(tree) if isinstance(tree, list) else ()
    items = tree.items() if isinstance(tree, dict) else lists
    for key, value in items:
        yield from places(value, (*way, key))


def nested(levels: int) -> Any:
    tree: Any = 1
    for _ in range(levels):
        tree = [tree]
    return tree


VALUES: tuple[Any, ...] = (
    *(None, True, "", "x", "\0", -1, 0, 1, 10**40, 1e308, float("nan"), float("inf")),
    *([], {}, [[]], {"": {}}, {"@rows": 0}, {"@rows": -1}, {"@rows": "x"}, {"@rows": 10**9}),
    *(["<f8", [3]], ["O", [1]], ["|V8", [1]], nested(60), nested(800)),
)


def mutated(rng: random.Random, tree: Told) -> Told:
    """A tree with some of its values changed, removed, exchanged or repeated."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.randint(1, 3)):
        *way, key = rng.choice([w for w in places(tree) if w])
        parent: Any = tree
        for step in way:
            parent = parent[step]
        match rng.randrange(4):
            case 0:
                del parent[key]
            case 1:
                *other, last = rng.choice([w for w in places(tree) if w])
                value: Any = tree
                for step in (*other, last):
                    value = value[step]
                parent[key] = copy.deepcopy(value)
            case 2 if isinstance(parent, list):
                parent.insert(key, parent[key])
            case _:
                parent[key] = rng.choice(VALUES)
    return tree


def test_structures_are_read_or_damaged(out: Path) -> None:
    newest, _ = saved(out)
    text, arrays = told(newest)
    text["content"][1]["recorder"]["writer"]["rows"] = []  # which are most of the places
    rng = random.Random(5)
    damaged = 0
    for _ in range(250):
        try:
            read(forged(newest, mutated(rng, text), arrays))
        except DamagedError:
            damaged += 1
    assert 100 < damaged < 250


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "null", "[" * 100_000, '{"content": 1}', "\udcff", '{"a":1}' * 2]
)
def test_texts_are_damaged(out: Path, text: str) -> None:
    newest, _ = saved(out)
    content = text.encode(errors="surrogateescape")
    for length in (len(content), 2**62):
        with pytest.raises(DamagedError):
            read(sealed(newest, length.to_bytes(WORD, "little") + content))


def at(*way: Any) -> Callable[[Told], Any]:
    """Gives the value at a place of the state."""

    def find(text: Told) -> Any:
        value = text["content"][1]
        for key in way:
            value = value[key]
        return value

    return find


jumps, solver = at("model", "mechanics", 0, "problem"), at("model", "mechanics", 0, "solver")
STATES: dict[str, Callable[[Told], Any]] = {
    "no rows": lambda text: jumps(text)["contact"].update(slip=0.5),
    "other rows": lambda text: (
        jumps(text)["contact"].update(slip=solver(text)["x"]["jump"])
        or jumps(text)["contact"].update(path=solver(text)["x"]["jump"])
    ),
    "no key": lambda text: jumps(text).pop("contact"),
    "text for a number": lambda text: solver(text).update(augmentation="large"),
    "text for numbers": lambda text: solver(text).update(scales=["large"]),
    "a step of nothing": lambda text: at("model", "motion", 0)(text).update(
        way={"step": 0.0, "done": 0.0, "cuts": 0}
    ),
    "no balance": lambda text: at("recorder")(text).update(balances=[]),
    "no contact": lambda text: at("recorder")(text).update(contact=[{}]),
    "text in the table": lambda text: at("recorder", "writer")(text).update(rows=[{"a": "=1+1"}]),
    "a table of nothing": lambda text: at("recorder", "writer")(text).update(rows=3),
    "a count of text": lambda text: at("recorder")(text).update(step="x"),
    "an unknown count": lambda text: at("recorder", "total")(text).update(more=1),
    "another time": lambda text: at("recorder")(text).update(timing={"solve": "long"}),
}


@pytest.mark.parametrize("name", STATES)
def test_a_state_that_does_not_fit_is_passed_over(
    run: Path, out: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    newest, _ = saved(out)
    text, arrays = told(newest)
    STATES[name](text)
    forged(newest, text, arrays)
    read(newest)
    kept = newest.read_bytes()
    assert restart(run, out) == 0
    said = "".join(capfd.readouterr())
    assert f"{newest} cannot be used" in said and "trying the one before" in said
    restarted.assert_same(run / "out", out)
    newest.write_bytes(kept)
    (out / "DONE").unlink()
    assert restart(run, out, str(newest)) == 2
    assert f"--restart {newest}: cannot be used" in capfd.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100))
def test_mutated_states(run: Path, out: Path, seed: int) -> None:
    """Whatever it holds, the run ends: with the one before, or with a number for a number."""
    newest, _ = saved(out)
    text, arrays = told(newest)
    text["content"][1] = mutated(random.Random(seed), text["content"][1])
    forged(newest, text, arrays)
    assert restart(run, out) in (0, 4, 6)


@pytest.mark.slow
def test_mutated_states_of_heat_and_cure(tmp_path: Path) -> None:
    """Temperatures over time are a table too, which has to be whole when it is drawn at the end."""
    (tmp_path / "case.yaml").write_text(restarted.SETTING)
    command = ["run", str(tmp_path / "case.yaml"), "-o", str(tmp_path / "out"), *FIELDS]
    assert main([*command, "--set", "output.checkpoint.steps=1"]) == 0
    (tmp_path / "out" / "DONE").unlink()
    for seed in range(40):
        out = Path(shutil.copytree(tmp_path / "out", tmp_path / f"out-{seed}"))
        newest, _ = saved(out)
        text, arrays = told(newest)
        rows = text["content"][1]["recorder"]["writer"]["rows"]
        text["content"][1]["recorder"]["writer"]["rows"] = rows[:1]  # which are most of the places
        text["content"][1] = mutated(random.Random(seed), text["content"][1])
        forged(newest, text, arrays)
        assert restart(tmp_path, out) in (0, 4, 6), seed


@pytest.mark.parallel
def test_ranks_pass_over_a_forged_one_together(run: Path, out: Path) -> None:
    newest, _ = saved(out)
    text, arrays = told(newest)
    STATES["no contact"](text)
    forged(newest, text, arrays)
    case = str(run / "case.yaml")
    support.on_ranks(2, "-m", "mantle", "run", case, "-o", out, *FIELDS, "--restart", "auto")
    restarted.assert_same(run / "out", out)


def test_the_file_before_was_of_one_rank(run: Path) -> None:
    """What the tests above change is what a run writes."""
    assert MPI.COMM_WORLD.size == 1
    text, arrays = told(saved(run / "out")[0])
    whole = checkpoint_file.read(saved(run / "out")[0])
    assert text["content"][0]["step"] == whole.header["step"] == 6 and arrays
