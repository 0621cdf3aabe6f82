"""A rigid ball pressed into an elastic hemisphere without friction: axisymmetric, second order."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu


def cup(inner: float, outer: float, E: float, ν: float, n: int) -> tuple[np.ndarray, ...]:
    """Compliance of the bore of a hemisphere held at its outside.

    It has n by n/6 cells of 9 nodes, n a multiple of 18.

    Returns:
        Angles of the bore's nodes from the pole (2n + 1,); their displacements away from the axis
        and along it by forces around the circle (2n + 1, 2, 2n + 1, 2) [mm/N]; the bore's mass
        matrix (2n + 1, 2n + 1) [mm^2].
    """
    θ, r = np.linspace(0, np.pi / 2, 2 * n + 1), np.linspace(inner, outer, n // 3 + 1)
    nodes = np.arange(len(θ) * len(r)).reshape(len(θ), len(r))
    cells = np.lib.stride_tricks.sliding_window_view(nodes, (3, 3))[::2, ::2].reshape(-1, 9)
    x = np.stack([np.outer(np.sin(θ), r), np.outer(np.cos(θ), r)], axis=-1).reshape(-1, 2)
    t, w = np.polynomial.legendre.leggauss(3)
    line = np.stack([t * (t - 1) / 2, 1 - t * t, t * (t + 1) / 2], axis=1)
    slope = np.stack([t - 0.5, -2 * t, t + 0.5], axis=1)
    N, dN = np.kron(line, line), np.stack([np.kron(slope, line), np.kron(line, slope)], axis=1)
    J = np.einsum("qan,cnb->cqab", dN, x[cells])
    g, ρ = np.linalg.inv(J) @ dN, x[cells, 0] @ N.T
    B = np.zeros((*ρ.shape, 4, 9, 2))  # strains along ρ and z, around, and the shear
    B[..., 0, :, 0] = B[..., 3, :, 1] = g[:, :, 0]
    B[..., 1, :, 1] = B[..., 3, :, 0] = g[:, :, 1]
    B[..., 2, :, 0] = N / ρ[..., None]
    B = B.reshape(*ρ.shape, 4, 18)
    D = E / (1 + ν) * np.diag([1, 1, 1, 0.5])
    D[:3, :3] += E * ν / (1 + ν) / (1 - 2 * ν)
    volume = 2 * np.pi * ρ * np.abs(np.linalg.det(J)) * np.outer(w, w).ravel()
    K = np.einsum("cq,cqki,kl,cqlj->cij", volume, B, D, B, optimize=True)
    dofs = (2 * cells[..., None] + [0, 1]).reshape(-1, 18)
    at = np.repeat(dofs, 18, axis=1).ravel(), np.tile(dofs, (1, 18)).ravel()
    free = np.ones(x.shape, bool)
    free[nodes[:, -1]] = free[nodes[0], 0] = False
    free = free.ravel().nonzero()[0]
    bore = (free[:, None] == (2 * nodes[:, :1] + [0, 1]).ravel()).astype(float)
    C = bore.T @ splu(sp.csc_matrix((K.ravel(), at))[free][:, free]).solve(bore)
    M = np.zeros((len(θ), len(θ)))
    for k in range(0, 2 * n, 2):
        area = 2 * np.pi * inner**2 * θ[1] * w * np.sin(θ[k + 1] + t * θ[1])
        M[k : k + 3, k : k + 3] += np.einsum("q,qi,qj->ij", area, line, line)
    return θ, C.reshape(len(θ), 2, len(θ), 2), M


def pressed(R: float, inner: float, outer: float, n: int, force: float = 2e3) -> tuple[float, ...]:
    """A ball pushed along the axis [N] into a cup of 1 GPa and 0.4; gaps are those of the sphere.

    Returns:
        The ball's way after first touch [mm], the mean pressure within 20 degrees of the pole
        [MPa] and the angle of the last node that touches [degrees].
    """
    θ, C, M = cup(inner, outer, 1e3, 0.4, n)
    x = inner * np.stack([np.sin(θ), np.cos(θ)], axis=1)
    u, f, touching = 0 * x, 0 * θ, θ < 0.5
    place = inner - R + 0.02
    for _ in range(50):
        away = x + u - [0, place]
        distance = np.linalg.norm(away, axis=1)
        normal = away / distance[:, None]
        (on,) = touching.nonzero()
        along = normal[on, 1:]
        A = np.einsum("ia,iajb->ijb", normal[on], C[on][:, :, on])
        A = np.einsum("ijb,jb->ij", A, normal[on])
        gap = (R - distance + (normal * u).sum(axis=1))[on]
        *pushed, step = np.linalg.solve(np.block([[A, -along], [along.T, 0]]), [*gap, force])
        f[:], f[on], place = 0, pushed, place + step
        old, u = u, np.tensordot(C, f[:, None] * normal)
        inside = np.linalg.norm(x + u - [0, place], axis=1) < R
        before, touching = touching, np.where(touching, f > 0, inside)
        touching[0] = True  # the pole has no area
        if (touching == before).all() and np.abs(u - old).max() < 1e-12:
            break
    else:
        raise RuntimeError("The contact did not settle.")
    near = θ < np.radians(20.01)
    p, ring = np.linalg.solve(M, f)[near], np.sin(θ[near])
    mean = np.trapezoid(p * ring) / np.trapezoid(ring)
    return float(place + R - inner), float(mean), float(np.degrees(θ[touching][-1]))
