r"""Creep: closed forms, and the problems of ``mantle verify`` that are compared with them.

Nothing of the forms comes from the code under test. Units as in `closed_forms`; N cycles or
seconds; a law is (A, p, m0, m1).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from itertools import product

import numpy as np

from app.results.reading import Run
from app.verification.check import Check, Sample, each, ladder, problem, row, run
from app.verification.measures import number, relative

Law = tuple[float, float, float, float]
# The law of creep_bar.yaml, and a plain one of Norton.
CEMENT: Law = (7.985e-7, 1.9063, 0.4113, -0.1160)
NORTON: Law = (1e-6, 4.0, 1.0, 0.0)
E = 2200.0
# Subsidence of creep_taper.yaml by 1e7 cycles of creep: of rings in plane strain under 3 MPa, by
# an integration of rates (tests/verification/test_creep_forms.py).
SUBSIDENCE = 0.15611  # mm


def strain(law: Law, s: float, N: float) -> float:
    """Creep strain at a constant stress."""
    A, p, m0, m1 = law
    return float(A * s**p * N ** (m0 + m1 * math.log10(s)))


def relaxed(law: Law, s: float, N: float) -> float:
    """Stress of a bar stretched to a stress s and held.

    By strain hardening dN/de is a function of e alone, as the stress is s - E e. In z = e^(1/m(s))
    it is smooth, and N(e) is its integral.
    """
    A, p, m0, m1 = law
    m = m0 + m1 * math.log10(s)
    z = np.linspace(0, (0.999 * s / E) ** (1 / m), 200_001)[1:]
    e = z**m
    now = s - E * e
    m_now = m0 + m1 * np.log10(now)
    slope = (A * now**p) ** (-1 / m_now) * e ** (1 / m_now - 1 / m) * m / m_now
    spent = np.concatenate([[0], np.cumsum((slope[1:] + slope[:-1]) / 2) * z[0]]) + slope[0] * z[0]
    return float(s - E * np.interp(N, spent, e))


def shrink_fit(a: float, b: float, δ: float, ν: float, t: float) -> float:
    """Pressure of a rigid core of radius a in a ring a < r < b of Maxwell's law [MPa].

    Too small by δ, plane strain, after t relaxation times of shear: with the elastic solution by
    correspondence, G s / (s + 1) in place of G, the inverse transform is two exponentials.
    """
    G, K = E / (2 + 2 * ν), E / (3 - 6 * ν)
    c = 2 * G * (1 / a**2 - 1 / b**2) * δ
    N1, N0 = (K + G / 3) * b * b * a, K * b * b * a
    D1 = a * a * G + b * b * (K + G / 3)
    s2 = -K * b * b / D1
    one, two = (N0 - N1) / (-1 - s2), (N1 * s2 + N0) / (1 + s2)
    return float(c / D1 * (one * math.exp(-t) + two * math.exp(s2 * t)))


def ring(run: Run, n: float) -> Sample:
    """Hoop less radial stress of fibre_ring.yaml once stationary, in cells, relative in L2 [MPa].

    (2 p/n) (b/r)^(2/n) / ((b/a)^(2/n) - 1). Their mean oscillates within cells, as volume is kept.
    """
    x, σ, volume = run.points[run.cells[:, :4]].mean(axis=1), run.stress(), run.volumes()
    r = np.hypot(x[:, 0], x[:, 1])
    radial = np.column_stack([x[:, 0], x[:, 1], 0 * r]) / r[:, None]
    hoop = np.column_stack([-x[:, 1], x[:, 0], 0 * r]) / r[:, None]
    along = [np.einsum("ci,cij,cj->c", d, σ, d) for d in (hoop, radial)]
    reference = 2 * 10 / n * (10 / r) ** (2 / n) / (2 ** (2 / n) - 1)
    error = np.average((along[0] - along[1] - reference) ** 2, weights=volume)
    return Sample(float(np.sqrt(error / np.average(reference**2, weights=volume))))


def subsidence(run: Run) -> Sample:
    """What the stem sinks by creep [mm]."""
    sunk = run.history["stem subsidence [mm]"]
    return relative(float(sunk[-1] - sunk[0]), SUBSIDENCE)


_BAR, _MISES = "verification/creep_bar.yaml", "bar.von_mises_max"


def _held(s: float) -> tuple[str, str]:
    """The bar stretched to a stress and held."""
    stretch = f"supports.end={{kind: displacement, boundary: top, z: {3 * s / E!r} mm}}"
    return "loads={}", stretch


def creep_problems() -> Iterator[Check]:
    """All problems of creep."""
    crept = [partial(number, name="bar.creep_strain_max", reference=strain(CEMENT, 5, 1e6))] * 2
    what = "creep strain at constant stress, in three jumps and by error, relative"
    fine = "stages.0.creep_tolerance=1e-6"
    runs = [("stages.0.adaptive=false", "stages.0.increments=3", fine), (fine,)]
    yield problem("creep_constant_stress", what, "creep_bar", crept, 1e-6, runs)

    norton = "regions.bar.creep={A: 1e-6, p: 4, m0: 1, per: 1 s}"
    held = (o.replace("{", "{{").replace("}", "}}") for o in (*_held(10), norton))
    second = "stages.0={{name: hold, creep_time: 1 s, adaptive: false, increments: {n}}}"
    left = partial(number, name=_MISES, reference=(1e-3 + 3 * E * 1e-6) ** (-1 / 3))
    what = "stress of a held bar by Norton's law, n = 4, in equal steps [MPa], relative"
    own, steps = (*held, second), (1 / 20, 1 / 40, 1 / 80, 1 / 160)
    yield ladder("creep_order", what, "creep_bar", left, 1e-3, own, steps, rung="step (s)")
    what = "stress of a held bar, by strain hardening [MPa], relative"
    relaxing = partial(number, name=_MISES, reference=relaxed(CEMENT, 10, 1e6))
    yield problem("creep_relaxation", what, "creep_bar", relaxing, 2e-3, [_held(10)])

    law = f"creep={{A: {2.6 / (3 * E)!r}, p: 1, m0: 1, per: 1 s}}"
    left = partial(
        number, name="stem_cement.pressure_mean", reference=shrink_fit(6, 10, 0.01, 0.3, 2)
    )
    size = [f"{key}=0.8 mm" for key in ("geometry.length", "mesh.size", "mesh.far_size")]
    fit = ("geometry.cement_thickness=2 mm", "geometry.bone_thickness=2 mm", *size, "mesh.order=2")
    fit = ("geometry.stem_radius=6 mm", *fit, "regions.stem={rigid: true}")
    creeps = (f"regions.cement.{law}", f"regions.bone.{law}")
    stage = "stages=[{name: fit, creep_time: 2 s, creep_tolerance: 2e-3}]"
    what = "pressure of a shrink fit that relaxes, two exponentials [MPa], relative"
    runs = [(*fit, *creeps, stage)]
    yield problem("creep_shrink_fit", what, "lame_plane_strain", left, 2e-3, runs)
    stage = "stages=[{name: hold, creep_time: 20 s}]"
    for n, A in ((2, 1e-5), (4, 1e-7)):
        law = f"creep: {{A: {A}, p: {n}, m0: 1, per: 1 s}}"
        material = f"{{youngs_modulus: 2200 MPa, poisson_ratio: 0.3, tissue: other, {law}}}"
        flows = ("mesh.order=2", "mesh.size=1 mm", f"regions.ring={material}", stage)
        what = f"hoop less radial stress of a ring that flows, n = {n} [MPa], relative in L2"
        yield problem(f"creep_ring_{n}", what, "fibre_ring", partial(ring, n=n), 5e-3, [flows])
    what = "subsidence of a taper by creep, against rings [mm], relative"
    yield problem("creep_taper", what, "creep_taper", subsidence, 5e-3)


def creep_rows() -> Iterator[Check]:
    """Rows of ``mantle stress``: stress over four decades, loaded and held; jumps over seven."""
    for s, jump in product((0.01, 0.1, 1.0, 10.0, 50.0), (0, 1, 10, 1e3, 1e5, 1e7)):
        load = f"loads.pull.pressure={-s} MPa"
        stage = f"stages.0={{name: jump, creep_cycles: {jump}, adaptive: false, "
        stage += "creep_tolerance: 1e-4}"
        crept = partial(number, name="bar.creep_strain_max")
        if jump:
            judge = each(partial(crept, reference=strain(CEMENT, s, jump)))
            yield row(f"creep/first jump/{s:g} MPa {jump:g}", run(_BAR, load, stage), judge, 1e-3)
        else:
            judge = each(partial(crept, reference=strain(CEMENT, s, 1e6)))
            yield row(f"creep/loaded/{s:g} MPa", run(_BAR, load), judge, 1e-3)
            held = each(partial(number, name=_MISES, reference=relaxed(CEMENT, s, 1e6)))
            yield row(f"creep/held/{s:g} MPa", run(_BAR, *_held(s)), held, 5e-3)
