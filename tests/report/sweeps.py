"""Made-up sweeps in the format of `mantle sweep`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from app.report.sweep_results import PERCENTILES, SweepResults, read
from app.schema import yaml_file

FRICTION = "interfaces.stem_cement.friction_coefficient"
MODULI = {"titanium": 110, "CoCr": 200}


def femur(stem: str = "titanium", thickness: float = 4.0, mu: float = 1.0) -> dict[str, Any]:
    """Keys of a case for reports."""
    return {
        "geometry": {"kind": "femur", "cement_thickness": f"{thickness:g} mm"},
        "mesh": {"size": "4 mm"},
        "regions": {"stem": {"youngs_modulus": f"{MODULI[stem]}000.0 MPa"}},
        "interfaces": {
            "stem_cement": {"kind": "contact", "friction_coefficient": 0.4},
            "cement_bone": {"friction_coefficient": mu, "conductance": "0.3 N/(mm s K)"},
        },
    }


class Maker:
    """Writes a sweep."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.cases: list[dict[str, Any]] = []

    def add(
        self, name: str, data: dict[str, Any], summary: dict[str, Any] | None, **more: Any
    ) -> Path:
        run = self.folder / "runs" / f"r{len(self.cases)}"
        run.mkdir(parents=True)
        (run / "case.yaml").write_text(yaml_file.to_yaml(data))
        if summary is not None:
            (run / "summary.json").write_text(json.dumps(summary))
        entry = {"name": name, "part": "thickness", "overrides": {}, "status": "converged"}
        entry |= {"folder": f"runs/{run.name}", "exit_code": 0, "message": "", "seconds": 12.0}
        self.cases.append(entry | more)
        return run

    def stance(self, stem: str, thickness: float, mu: float, numbers: Any, **more: Any) -> Path:
        """A case of single-limb stance; numbers by interface."""
        name = more.pop("name", f"{stem} {thickness:g} {mu:g}")
        summary = None if numbers is None else {"interfaces": numbers} | more.pop("summary", {})
        return self.add(name, femur(stem, thickness, mu), summary, **more)

    def write(self, **more: Any) -> Path:
        content: dict[str, Any] = {"title": "made up", "file": "x.yaml"}
        content |= {"program": "0", "cores": 2, "seconds": 9, "cases": self.cases} | more
        (self.folder / "sweep.json").write_text(json.dumps(content))
        return self.folder


Law = Callable[[str, float, float, str], float]


# Quantities of an interface with cement; motion has the values of slip.
CEMENTED = ("gap", "slip", "motion", "pressure", "shear")


def contact(law: Law, stem: str, t: float, mu: float, error: float) -> dict[str, Any]:
    """Numbers of both interfaces: the percentile by a law, and twice that as maximum."""
    interfaces: dict[str, Any] = {}
    for place in ("cement_bone", "stem_cement"):
        interfaces[place] = {"area": 100.0}
        interfaces[place] |= {f"area_{q}_over_30um": 40.0 for q in ("slip", "motion")}
        interfaces[place]["area_gap_over_30um"] = 1.0
        for quantity in CEMENTED:
            unit = 1 if quantity in ("pressure", "shear") else 1e-3
            value = unit * law(stem, t, mu, f"{place}.{quantity}")
            part = PERCENTILES[quantity]
            interfaces[place] |= {f"{quantity}_{part}": value, f"{quantity}_max": 2 * value}
            interfaces[place][f"{quantity}_{part}_error"] = error * value
    return interfaces


def as_the_paper_says(stem: str, t: float, mu: float, name: str) -> float:
    """Numbers for which every mechanical trend holds."""
    thin = 5.0 if t < 2.5 else 1.0
    name = name.replace("motion", "slip")
    return {
        "cement_bone.gap": 30 * thin * (0.5 + mu / 2),
        "cement_bone.slip": 60 * thin * (2 - mu),
        "cement_bone.pressure": 4 * (0.5 + mu / 2),
        "cement_bone.shear": 2.0,
        "stem_cement.gap": 60 * (2 - mu),
        "stem_cement.slip": 100 * (0.5 + mu / 2),
        "stem_cement.pressure": 7.0,
        "stem_cement.shear": 3.0,
    }[name]


def sweep(maker: Maker, law: Law, error: float) -> SweepResults:
    for stem in MODULI:
        for t in (2.0, 3.0, 4.0, 5.0, 7.0):
            maker.stance(stem, t, 1.0, contact(law, stem, t, 1.0, error))
        for mu in (0.4, 0.7):
            maker.stance(stem, 4.0, mu, contact(law, stem, 4.0, mu, error))
    return read(maker.write())


def zones(density: float, places: tuple[str, ...]) -> dict[str, Any]:
    numbers = {"gap_max": 0.02, "gap_mean": 0.01}
    return {
        str(z): {
            "strain_energy_density": {"cortical_bone": z * density},
            "interfaces": dict.fromkeys(places, numbers),
        }
        for z in range(1, 15)
    }
