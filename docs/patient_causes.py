r"""Print the table of docs/howto/patient.md: from the parametric hip to a patient's by causes.

    ./mantle shell -c 'python3 docs/patient_causes.py femur.stl canal.stl out/causes'

Files in mm. Four hips: a quarter of a minute each on an idle core.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import mantle
from app import extensions  # noqa: F401  (registers keys that cases have)
from app.case.case import load_case
from meshes import femur_stem

# Length of the stem [mm].
LENGTH = 130.0
# Version of the stem to the neck [deg].
ANGLE = -10.0
# Height of the distal cut.
CUT = "-173.1 mm"
# Size of cells.
SIZE = "8 mm"


def patient(bone: Path, azimuth: str | None, varus: float = 0.0, **keys: Any) -> dict[str, Any]:
    """A patient's hip; without an azimuth the cut is along the neck."""
    cut = {"height": "8 mm", "angle": "38 deg"} | ({"azimuth": azimuth} if azimuth else {})
    insertion = {"varus": f"{varus} deg", "version": {"angle": f"{ANGLE} deg"}}
    files = {"kind": "patient", "bone": {"surface": str(bone), "unit": "mm"}, "distal_cut_z": CUT}
    stem = {"stem": {"length": f"{LENGTH} mm"}}
    return files | stem | {"resection": cut, "insertion": insertion} | keys


def parametric(version: float, tip: float) -> dict[str, Any]:
    """The parametric hip with the same stem, its tip at a level [mm]."""
    levels = {"tip_z": f"{tip} mm", "distal_cut_z": CUT, "resection": {"height": "8 mm"}}
    rotated = {"kind": "femur", "anteversion": f"{version} deg"}
    return rotated | levels | {"stem": {"length": f"{LENGTH} mm"}}


def main(bone: Path, canal: Path, folder: Path) -> None:
    """Write, run and print."""
    folder.mkdir(parents=True, exist_ok=True)

    def case(name: str, geometry: dict[str, Any]) -> Path:
        data = {"base": "stance", "title": name, "geometry": geometry, "mesh": {"size": SIZE}}
        path = folder / f"{name.replace(' ', '_')}.yaml"
        path.write_text(json.dumps(data | {"loads": {"library": "one_leg_stance"}}))
        return path

    broached = {"surface": str(canal), "ream": "broach"}
    real = load_case(case("the patient", patient(bone, None, 1.0, canal=broached))).config
    neck = math.degrees(real.geometry.femur.neck)
    version = round(neck + ANGLE, 2)
    azimuth = f"{version} deg"
    femur = load_case(case("base", parametric(version, -101.0))).config.geometry
    placement = femur.placement
    half = float(femur_stem.shaft_of(femur.implant).section(LENGTH - 101.0)[0])
    tip = round(placement.top + placement.slopes[0] * half - LENGTH, 3)
    cases = [
        case("parametric", parametric(version, tip)),
        case("shape", patient(bone, azimuth)),
        case("canal", patient(bone, azimuth, canal=broached)),
        case("the patient", patient(bone, None, 1.0, canal=broached)),
    ]
    for path in cases:
        summary = mantle.run(mantle.load(path), folder / "out" / path.stem).summary
        stem, bone_side = (summary["interfaces"][name] for name in ("stem_cement", "cement_bone"))
        numbers = [(summary["stem"], "subsidence")]
        numbers += [(side, key) for side in (stem, bone_side) for key in ("slip_p99", "gap_p99")]
        cells = [f"{1e3 * n[key]:.1f} ± {1e3 * n[f'{key}_error']:.1f}" for n, key in numbers]
        sys.stdout.write(f"| {path.stem} | {' | '.join(cells)} |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(*(Path(name).resolve() for name in sys.argv[1:4]))
