"""Published numbers of interfaces.

All functions are collective and return the same plain values on every rank. Percentiles are
weighted by area or volume; maxima are reported beside them because peaks at edges grow with
refinement.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from app.arrays import Floats, Ints
from app.case.quantities import computed
from app.mechanics.contact import TrialState
from app.mechanics.problem import Problem
from app.results.penetration import overlap
from app.results.percentiles import SurfaceField
from forms.contact import OPEN, SLIP, STICK

MICROMOTION = 0.030  # mm: where biology reacts


def _pressure(pressures: Floats, normals: Floats) -> Floats:
    """Normal force per area (n,) [MPa], from those of the faces of each point (n, 3).

    Negative is tension, possible for laws that cannot open.
    """
    size = np.linalg.norm(np.einsum("pk,pki->pi", pressures, normals), axis=1)
    return np.where(pressures.sum(axis=1) < 0, -size, size)


class ContactSamples:
    """Contact points of all ranks, in canonical order, on every rank.

    One row per point for vectors, one per point and face for what belongs to a face.

    Attributes:
        interface: Interface of each point (n,).
        x: Position (n, 3) [mm].
        weight: Area (n,) [mm2].
        gap: Opening of each face (n, 3) [mm]; 0 beyond the point's faces.
        opening: Opening of the point, the largest of its faces (n,) [mm].
        slip: Net sliding while in contact (n, 3) [mm].
        path: Length of the path of the slip (n,) [mm].
        motion: Displacement of the second side as declared against the first (n, 3) [mm].
        pressure: Normal force per area, positive in compression (n,) [MPa].
        shear: Friction per area (n,) [MPa].
        force: Force of the first side on the second, as declared, per area (n, 3) [MPa].
        status: State (n,).
        overlap: Penetration between the points of each interface, by name [mm].
        dissipation: Dissipated by friction (n,) [N mm].
        least: Smallest dissipation of any step, 0 at most (n,) [N mm].
        contact_work: Work of the pressures in the opening (n,) [N mm].
        own: History variables of the laws, by name: (n, ...).
        edge_lengths: Mean edge of the facets of each interface [mm].
        found: What `interface` has found of them, by interface.
    """

    def __init__(self, problem: Problem, trial: TrialState) -> None:
        self.found: dict[int, dict[str, Any]] = {}
        contact, history = trial.contact, trial.contact.state
        opening = np.einsum("pi,pki->pk", trial.jump + contact.gap, contact.own.normals)
        # The second side as declared is the slave or the master.
        contacts = problem.scene.contacts
        sign = np.array([-1.0 if c.turned else 1.0 for c in contacts])[contact.own.interface][
            :, None
        ]
        used = np.arange(3)[None, :] < contact.own.faces[:, None]
        local = {
            "row": contact.own.rows,
            "gap": np.where(used, opening, 0.0),
            "opening": np.max(opening, axis=1, where=used, initial=-np.inf),
            "slip": sign * history.slip,
            "path": history.path,
            "motion": sign * trial.jump,
            "pressure": _pressure(trial.law.pressures, contact.own.normals),
            "shear": np.linalg.norm(history.friction, axis=1),
            "force": -sign * history.force,
            "status": np.where(contact.own.faces > 0, trial.law.status, STICK),
            "dissipation": history.dissipation,
            "least": history.least,
            "contact_work": history.contact_work,
            **{f"own {name}": values for name, values in history.own.items()},
        }
        pieces = problem.comm.allgather(local)
        whole = {key: np.concatenate([p[key] for p in pieces]) for key in local}
        order = np.argsort(whole.pop("row"))
        self.points, self.edge_lengths = contact.points, contact.edge_lengths
        self.interface, self.x = contact.points.interface, contact.points.x
        self.weight = contact.points.weight
        self.gap, self.opening, self.slip, self.path, self.motion = (
            whole[k][order] for k in ("gap", "opening", "slip", "path", "motion")
        )
        self.pressure, self.shear, self.force, self.status = (
            whole[k][order] for k in ("pressure", "shear", "force", "status")
        )
        self.dissipation, self.least, self.contact_work = (
            whole[k][order] for k in ("dissipation", "least", "contact_work")
        )
        self.own = {name: whole[f"own {name}"][order] for name in history.own}
        self.overlap = overlap(contact, trial.jump)


def interface(problem: Problem, samples: ContactSamples, i: int) -> dict[str, Any]:
    """Motion, tractions and states of one interface; computed once for each state."""
    if i not in samples.found:
        samples.found[i] = _interface(problem, samples, i)
    return dict(samples.found[i])


def _interface(problem: Problem, s: ContactSamples, i: int) -> dict[str, Any]:
    at = s.interface == i
    weight, x = s.weight[at], s.x[at]
    total = float(weight.sum())
    facets = Facets(s, i)
    found: dict[str, Any] = {}
    for name, values in (
        ("gap", np.maximum(s.gap, 0.0)),
        ("slip", np.linalg.norm(s.slip, axis=1)),
        ("slip_path", s.path),
        ("motion", np.linalg.norm(s.motion, axis=1)),
        ("pressure", s.pressure),
        ("shear", s.shear),
    ):
        field = facets.field(values)
        here = values[at].reshape(len(x), -1).max(axis=1)
        k = int(np.argmax(here))
        found |= {
            f"{name}_max": float(max(here[k], 0.0)),
            f"{name}_p95": field.percentile(0.95),
            f"{name}_p99": field.percentile(0.99),
            f"{name}_mean": field.mean(),
            f"{name}_max_at": [float(c) for c in x[k]],
        }
        if name in ("gap", "slip", "motion"):
            found[f"area_{name}_over_30um"] = field.area_above(MICROMOTION)

    def fraction(state: int) -> float:
        return float(weight[s.status[at] == state].sum()) / total

    return {
        **found,
        "penetration_max": float(np.maximum(-s.gap[at], 0.0).max()),
        **s.overlap[i],
        "open_fraction": fraction(OPEN),
        "stick_fraction": fraction(STICK),
        "slip_fraction": fraction(SLIP),
        "area": total,
        "facet_size": s.edge_lengths[i],
        "force": [float(c) for c in (weight[:, None] * s.force[at]).sum(axis=0)],
        "dissipation": float(s.dissipation[at].sum()),
        "dissipation_min": float(s.least[at].min()),
        "contact_work": float(s.contact_work[at].sum()),
        **computed("interfaces", s, at),
    }


class Facets:
    """Facets of an interface: its points are their corners.

    Attributes:
        triangles: Contact points at the corners (f, 3).
        area: Areas (f,) [mm2].
    """

    def __init__(self, s: ContactSamples, i: int) -> None:
        self.triangles: Ints = s.points.triangles[i]
        x = s.x[self.triangles]
        flat = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        area = np.linalg.norm(flat, axis=1) / 2
        # Curved facets have a little more than their corners span.
        whole = s.weight[s.interface == i].sum()
        self.area = area * (whole / area.sum()) if len(area) else area
        # At each corner the face of the point that this facet belongs to.
        along = np.abs(np.einsum("fi,fcki->fck", flat, s.points.normals[self.triangles]))
        self._face: Ints = np.argmax(along, axis=2)

    def field(self, values: Floats) -> SurfaceField:
        """Values at points (n,), or at the faces of points (n, 3), as a field on the facets."""
        corners = values[self.triangles]
        if values.ndim == 2:
            corners = np.take_along_axis(corners, self._face[:, :, None], axis=2)[:, :, 0]
        return SurfaceField(corners, self.area)
