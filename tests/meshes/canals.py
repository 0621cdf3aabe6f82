"""Straight round canals and rods, which have a known best position."""

from __future__ import annotations

import math

import numpy as np

from app.case.stems import Stem
from app.foundation.arrays import Floats
from meshes import room
from meshes.placement import CutPlane, Position
from meshes.room import StemSurface

RADIUS = 9.0  # of a straight canal [mm]
IMPLANT = Stem().implant(None, 10.0, 0.0)
CUT = CutPlane(np.array([math.sin(0.6), 0.0, math.cos(0.6)]), 20.0, np.array([1.0, 0.0]))
START = Position(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def tube(foot: tuple[float, float], tilt: tuple[float, float]) -> Floats:
    """Points of a straight round canal about an axis (n, `AROUND`, 3) [mm]."""
    theta, z = np.meshgrid(
        2 * np.pi * np.arange(room.CANAL_AROUND) / room.CANAL_AROUND,
        np.arange(-190.0, 45.0, room.CANAL_STEP),
    )
    x = foot[0] + tilt[0] * z + RADIUS * np.cos(theta)
    return np.stack([x, foot[1] + tilt[1] * z + RADIUS * np.sin(theta), z], axis=-1)


def rod(half: float) -> StemSurface:
    """A round rod as a stem [mm]."""
    theta, z = np.meshgrid(2 * np.pi * np.arange(24) / 24, np.linspace(-140.0, 20.0, 81))
    points = np.stack([half * np.cos(theta), half * np.sin(theta), z], axis=-1)
    return StemSurface(IMPLANT, points[0], np.zeros((24, 3)), points)
