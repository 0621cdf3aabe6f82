"""A stand-in for ``mantle run`` that leaves what a run leaves, in no time.

Its numbers follow laws in the mesh size h, the friction and the penalty r, if there is one. Orders,
references and advice are therefore known:

* slip_p99 = 0.04 (1 - 0.01 h^2) (1 + 10 / r) / friction
* pressure_p99 = 5 (1 + 0.04 h / order)
* penetration_max = 2 / r
* time = 8 / h seconds
* estimated errors: twice and eight times the true ones

Files in the folder of `conftest.Bench` control it:

* ``broken``: sizes, frictions and penalties that fail; ``code``: exit code of these runs
* ``interrupted``: exit code of an interrupted run
* ``seconds``: duration of a run
* ``meet``: number of runs that wait for each other
* ``awaited``: file for which all runs but the first wait
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

HERE = Path(sys.argv[1])
CASE = Path(sys.argv[2])
OUTPUT = Path(sys.argv[4])
DATA = YAML(typ="safe").load(CASE.read_text())
LAW = "lower_upper"  # interface of the case
PATIENCE = 60.0  # s


def setting(name: str) -> str:
    return (HERE / name).read_text()


def number(quantity: object) -> float:
    return float(str(quantity).partition(" ")[0])


def note(name: str, *words: object) -> None:
    with (HERE / name).open("a") as file:
        file.write(" ".join(map(str, words)) + "\n")


def wait() -> None:
    """Sleep for the requested time; wait for runs at the same time, or for a file."""
    running, met, end = HERE / "running", HERE / "met", time.monotonic() + PATIENCE
    running.mkdir(exist_ok=True)
    (running / OUTPUT.name).touch()
    time.sleep(float(setting("seconds")))
    while not met.exists() and time.monotonic() < end:
        many = len(list(running.iterdir()))
        if many > 1:
            met.touch()
        if many >= int(setting("meet")):
            break
        time.sleep(0.02)
    while (HERE / "runs").exists() and not (HERE / setting("awaited")).exists():
        if time.monotonic() > end:
            break
        time.sleep(0.02)
    (running / OUTPUT.name).unlink()


def summary(h: float, friction: float, r: float) -> dict[str, Any]:
    slip, rough = 0.04 * (1 - 0.01 * h**2) * (1 + 10 / r) / friction, h / DATA["mesh"]["order"]
    numbers = {"slip_p99": round(slip, 15), "pressure_p99": 5 * (1 + 0.04 * rough)}
    numbers["penetration_max"] = 2 / r
    if DATA.get("output", {}).get("error"):
        numbers |= {"slip_p99_error": 8e-4 * h**2 / friction, "pressure_p99_error": 1.6 * rough}
    solver = {"dofs": 3, "steps": 1, "newton_iterations": 4, "linear_iterations": 5}
    timing = {"mesh": 3.0, "compile": 2.0, "error": 1.0, "total": 6.0 + 8 / h}
    return {
        "size": h,
        "interfaces": {LAW: numbers},
        "timing": timing,
        "solver": solver | {"condition": 1e5},
    }


def main() -> int:
    h, code = number(DATA["mesh"]["size"]), 0
    note("calls", f"{h:g}", *sys.argv[5:], os.environ["OMP_NUM_THREADS"])
    variations = DATA.get("variations", {})
    for name, changes in (variations or {"": {}}).items():
        folder = OUTPUT / name
        if (folder / "DONE").exists():
            continue
        law = changes.get(f"interfaces.{LAW}", DATA["interfaces"][LAW])
        friction = law.get("friction_coefficient", 1.0)
        r = number(law["penalty"]) if "penalty" in law else float("inf")
        folder.mkdir(parents=True, exist_ok=True)
        if {h, friction, r} & set(map(float, setting("broken").split())):
            print("the mesh is bad\nthe block slides away")
            code = int(setting("code"))
            if not variations or code != 4:
                break
            (folder / "FAILED").write_text("the block slides away\n")
            continue
        wait()
        (folder / "summary.json").write_text(json.dumps(summary(h, friction, r)))
        (folder / "DONE").write_text("")
        note("runs", DATA["regions"]["lower"]["youngs_modulus"], friction)
    return code


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(int(setting("interrupted")))
