"""Everything a user can get wrong in a case file, with the line, column and words that tell it.

Each entry edits a good file and names every complaint that has to come, in order, none besides.
"""

from __future__ import annotations

import errno
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from app import cli
from app.case.case import load
from app.case.femurs import Femur
from app.cli import main
from app.errors import InputError
from app.system import ranks

GOOD = """\
title: press
geometry:
  kind: cylinders
  stem_radius: 7 mm
  cement_thickness: 4 mm
  bone_thickness: 6 mm
  length: 20 mm
mesh:
  size: 2 mm
regions:
  stem:
    youngs_modulus: 110 GPa
    poisson_ratio: 0.3
  cement: {youngs_modulus: 2.2 GPa, poisson_ratio: 0.3}
  bone:
    kind: transversely_isotropic
    axial_youngs_modulus: 17 GPa
    transverse_youngs_modulus: 11.5 GPa
    axial_poisson_ratio: 0.31
    transverse_poisson_ratio: 0.51
    axial_shear_modulus: 3.3 GPa
interfaces:
  stem_cement:
    kind: contact
    friction_coefficient: 0.4
    gap: -0.01 mm
  cement_bone: {kind: bonded}
supports:
  base: {kind: fixed, boundary: bone_surface}
loads:
  push:
    kind: force
    boundary: stem_top
    force: [0 N, 0 N, -100 N]
    history: [0.5, 1]
stages:
  - name: press_fit
  - name: push_in
solver:
  tolerance: 1e-10
"""

HOT = """\
geometry:
  kind: cylinders
  stem_radius: 7 mm
  cement_thickness: 4 mm
  bone_thickness: 6 mm
  length: 20 mm
mesh: {size: 2 mm}
regions:
  stem:
    rigid: true
    thermal:
      conductivity: 14.8 W/(m K)
      density: 8300 kg/m^3
      specific_heat: 450 J/(kg K)
      initial_temperature: 22 degC
  cement:
    youngs_modulus: 2.2 GPa
    poisson_ratio: 0.3
    thermal:
      conductivity: 0.2 W/(m K)
      density: 1200 kg/m^3
      specific_heat: 1450 J/(kg K)
      initial_temperature: 22 degC
      thermal_expansion: 80e-6 1/K
      cure:
        kinetics:
          kind: autocatalytic
          rate_constant: 2.6397e8 1/s
          activation_energy: 62866 J/mol
          m: 0.98
          n: 1.064
          limit: [[20 degC, 0.9], [100 degC, 1]]
        heat: 1.55e8 J/m^3
        gel: 0.85
  bone:
    youngs_modulus: 17 GPa
    poisson_ratio: 0.3
    thermal:
      axial_conductivity: 0.6 W/(m K)
      transverse_conductivity: 0.5 W/(m K)
      fibre: [0, 0, 1]
      density: 1850 kg/m^3
      specific_heat: 1260 J/(kg K)
      initial_temperature: 37 degC
interfaces:
  stem_cement:
    kind: contact
    friction_coefficient: 0.4
    conductance: {kind: pressure, open: 100 W/(m^2 K), per_pressure: 50 W/(m^2 K MPa)}
    friction_heating: effusivity
  cement_bone: {kind: bonded, conductance: 1000 W/(m^2 K)}
supports:
  base: {kind: fixed, boundary: bone_surface}
  hold: {kind: fixed, boundary: stem_top, stages: [setting]}
heat:
  blood:
    kind: perfusion
    regions: [bone]
    rate: 0.003 1/s
    blood_density: 1060 kg/m^3
    blood_specific_heat: 3770 J/(kg K)
    temperature: 37 degC
  outside: {kind: temperature, boundary: bone_surface, temperature: 37 degC}
  lamp: {kind: flux, boundary: stem_top, flux: 100 W/m^2, course: [[0 s, 1], [10 s, 0]]}
stages:
  - {name: setting, duration: 1 hour}
  - {name: rest}
time: {tolerance: 1e-3 K}
output:
  probes: {middle: {at: "[9, 0, 10] mm", region: cement}}
"""

SYNTAX = "not valid YAML"
TABLE: dict[str, tuple[list[tuple[str, str]], list[str]]] = {
    "unknown key": (
        [("length: 20 mm", "lenght: 20 mm")],
        [
            "2:1: geometry: 'length' is missing; expected: length along z",
            "7:3: geometry.lenght: unknown key; allowed: kind, stem_radius, cement_thickness, "
            "bone_thickness, length, taper, sector; did you mean 'length'?",
        ],
    ),
    "unknown section": (
        [("solver:", "sover:")],
        ["39:1: sover: unknown key; allowed: title, geometry,"],
    ),
    "unknown key in an interface": (
        [("friction_coefficient: 0.4", "friction_coeficient: 0.4")],
        [
            "23:3: interfaces.stem_cement: 'friction_coefficient' is missing",
            "25:5: interfaces.stem_cement.friction_coeficient: unknown key; allowed: kind, "
            "conductance, friction_coefficient, gap, gap_history, friction_heating, augmentation; "
            "did you mean 'friction_coefficient'?",
        ],
    ),
    "the beginning of two keys": (
        [("friction_coefficient: 0.4", "friction: 0.4")],
        [
            "23:3: interfaces.stem_cement: 'friction_coefficient' is missing",
            "25:5: interfaces.stem_cement.friction: unknown key; allowed: kind, "
            "conductance, friction_coefficient, gap, gap_history, friction_heating, augmentation; "
            "did you mean 'friction_coefficient' or 'friction_heating'?",
        ],
    ),
    "duplicate key": (
        [
            (
                "    poisson_ratio: 0.3\n  cement",
                "    youngs_modulus: 1 GPa\n    poisson_ratio: 0.3\n  cement",
            )
        ],
        ["13:5: regions.stem.youngs_modulus: this key stands here twice; keep one"],
    ),
    "duplicate section": (
        [("solver:\n", "mesh: {}\nsolver:\n")],
        ["39:1: mesh: this key stands here twice; keep one"],
    ),
    "missing section": (
        [("mesh:\n  size: 2 mm\n", "")],
        ["1:1: 'mesh' is missing; expected: mesh size and order"],
    ),
    "missing unit, whole number": (
        [("length: 20 mm", "length: 20")],
        ["7:3: geometry.length: 20 needs a unit, e.g. '20 mm'"],
    ),
    "missing unit, zero": (
        [("gap: -0.01 mm", "gap: 0")],
        ["26:5: interfaces.stem_cement.gap: 0 needs a unit, e.g. '0 mm'"],
    ),
    "missing unit, text": (
        [("size: 2 mm", "size: '2'")],
        ["9:3: mesh.size: '2' needs a unit, e.g. '2 mm'"],
    ),
    "missing unit in a vector": (
        [("0 N, -100 N]", "0 N, -100]")],
        ["34:23: loads.push.force[2]: -100 needs a unit, e.g. '-100 N'"],
    ),
    "wrong dimension": (
        [("110 GPa", "110 mm")],
        [
            "12:5: regions.stem.youngs_modulus: '110 mm' is a length; expected a stress "
            "such as '110 GPa'"
        ],
    ),
    "wrong dimension, compound": (
        [("110 GPa", "110 N/mm")],
        ["12:5: regions.stem.youngs_modulus: '110 N/mm' is a force per length; expected a stress"],
    ),
    "unknown unit": (
        [("110 GPa", "110 GPA")],
        [
            "12:5: regions.stem.youngs_modulus: '110 GPA': 'GPA' is not a unit; "
            "expected a stress such as '110 GPa'; did you mean 'GPa'?"
        ],
    ),
    "unit on a plain number": (
        [("friction_coefficient: 0.4", "friction_coefficient: 0.4 mm")],
        [
            "25:5: interfaces.stem_cement.friction_coefficient: '0.4 mm' is not a number; "
            "expected a plain number (this value is dimensionless: no unit)"
        ],
    ),
    "quoted number": (
        [("poisson_ratio: 0.3\n", "poisson_ratio: '0.3'\n")],
        [
            "13:5: regions.stem.poisson_ratio: '0.3' is not a number; expected a plain "
            "number without"
        ],
    ),
    "thousands separator": (
        [("-100 N]", "'-1,000 N']")],
        ["34:23: loads.push.force[2]: '-1,000 N': ',000 N' is not a unit"],
    ),
    "bool for a number": (
        [("friction_coefficient: 0.4", "friction_coefficient: true")],
        ["25:5: interfaces.stem_cement.friction_coefficient: true is not a number"],
    ),
    "number for a bool": (
        [("size: 2 mm", "size: 2 mm\n  curved: 1")],
        ["10:3: mesh.curved: 1 is not true or false"],
    ),
    "infinite": (
        [("friction_coefficient: 0.4", "friction_coefficient: .inf")],
        ["25:5: interfaces.stem_cement.friction_coefficient: inf is not finite; expected a number"],
    ),
    "infinite with unit": (
        [("110 GPa", ".inf GPa")],
        ["12:5: regions.stem.youngs_modulus: '.inf GPa' is not finite; expected a stress"],
    ),
    "not a number": (
        [("0.31", ".nan")],
        ["19:5: regions.bone.axial_poisson_ratio: nan is not finite; expected a number"],
    ),
    "overflow": (
        [("110 GPa", "1e400 GPa")],
        ["12:5: regions.stem.youngs_modulus: '1e400 GPa' is not finite"],
    ),
    "negative length": (
        [("stem_radius: 7 mm", "stem_radius: -7 mm")],
        ["4:3: geometry.stem_radius: '-7 mm' must be positive"],
    ),
    "negative friction": (
        [("friction_coefficient: 0.4", "friction_coefficient: -0.1")],
        ["25:5: interfaces.stem_cement.friction_coefficient: -0.1 must not be negative"],
    ),
    "two keys on a line": (
        [("name: push_in", "name: push_in, increments: 2.5")],
        [f"38:30: {SYNTAX}: mapping values are not allowed here"],
    ),
    "increments not whole": (
        [("- name: push_in", "- {name: push_in, increments: 2.5}")],
        ["38:21: stages[1].increments: 2.5 is not a whole number"],
    ),
    "order out of range": (
        [("size: 2 mm", "size: 2 mm\n  order: 3")],
        ["10:3: mesh.order: 3 must be at most 2"],
    ),
    "far size below size": (
        [("size: 2 mm", "size: 2 mm\n  far_size: 1 mm")],
        ["10:3: mesh.far_size: 1 mm is finer than size, 2 mm"],
    ),
    "isotropic not positive definite": (
        [("poisson_ratio: 0.3\n", "poisson_ratio: 0.5\n")],
        [
            "13:5: regions.stem.poisson_ratio: the stiffness is not positive definite; "
            "expected -1 < poisson_ratio < 0.5"
        ],
    ),
    "negative modulus": (
        [("110 GPa", "-110 GPa")],
        [
            "12:5: regions.stem.youngs_modulus: the stiffness is not positive definite; "
            "expected youngs_modulus > 0"
        ],
    ),
    "transversely isotropic not positive definite": (
        [("0.31", "0.7")],
        [
            "19:5: regions.bone.axial_poisson_ratio: the stiffness is not positive "
            "definite; expected "
            "1 - transverse_poisson_ratio - 2 axial_poisson_ratio^2 transverse_youngs_modulus / "
            "axial_youngs_modulus > 0 (it is -0.173)"
        ],
    ),
    "transverse ratio of one": (
        [("0.51", "1")],
        ["20:5: regions.bone.transverse_poisson_ratio: the stiffness is not positive definite"],
    ),
    "fibre zero": (
        [("3.3 GPa", "3.3 GPa\n    fibre: [0, 0, 0]")],
        ["22:5: regions.bone.fibre: is the zero vector; expected a direction"],
    ),
    "fibre of two": (
        [("3.3 GPa", "3.3 GPa\n    fibre: [0, 1]")],
        ["22:5: regions.bone.fibre: has 2 values; expected three, e.g. [0, 0, 1]"],
    ),
    "fibre about a wrong axis": (
        [("3.3 GPa", "3.3 GPa\n    fibre: {kind: radial, axis: [0, 0, 0], through: [1, 2, 3]}")],
        [
            "22:27: regions.bone.fibre.axis: is the zero vector; expected a direction",
            "22:54: regions.bone.fibre.through[0]: 1 needs a unit, e.g. '1 mm'",
            "22:57: regions.bone.fibre.through[1]: 2 needs a unit",
            "22:60: regions.bone.fibre.through[2]: 3 needs a unit",
        ],
    ),
    "fibre of an unknown kind": (
        [("3.3 GPa", "3.3 GPa\n    fibre: {kind: hoop, axis: [0, 0, 1]}")],
        ["22:13: regions.bone.fibre.kind: 'hoop' is not one of circumferential, radial"],
    ),
    "fibre of no kind": (
        [("3.3 GPa", "3.3 GPa\n    fibre: {axis: [0, 0, 1]}")],
        ["22:5: regions.bone.fibre.kind: is missing; expected one of circumferential, radial"],
    ),
    "fibre about an axis with an unknown key": (
        [("3.3 GPa", "3.3 GPa\n    fibre: {kind: circumferential, origin: [0 mm, 0 mm, 0 mm]}")],
        ["22:36: regions.bone.fibre.origin: unknown key; allowed: kind, axis, through"],
    ),
    "fibre in a word": (
        [("3.3 GPa", "3.3 GPa\n    fibre: radial")],
        ["22:5: regions.bone.fibre: 'radial' is not a list of three values; expected e.g."],
    ),
    "unknown kind of interface": (
        [("kind: bonded", "kind: glued")],
        ["27:17: interfaces.cement_bone.kind: 'glued' is not one of bonded, contact, penalty"],
    ),
    "misspelled kind": (
        [("kind: bonded", "kind: bonde")],
        [
            "27:17: interfaces.cement_bone.kind: 'bonde' is not one of bonded, contact, penalty; "
            "did you mean 'bonded'?"
        ],
    ),
    "missing kind": (
        [("{kind: fixed, ", "{")],
        [
            "29:3: supports.base.kind: is missing; expected one of fixed, roller, "
            "displacement, foundation"
        ],
    ),
    "unknown geometry": (
        [("kind: cylinders", "kind: cylinder")],
        [
            "3:3: geometry.kind: 'cylinder' is not one of blocks, cylinders, femur, "
            "intact_femur, file; did you mean"
        ],
    ),
    "kind that is no word": (
        [("kind: cylinders", "kind: [cylinders]")],
        ["3:3: geometry.kind: a list is not one of blocks, cylinders, femur, intact_femur, file"],
    ),
    "unknown region and missing material": (
        [("  cement: {", "  cemnt: {")],
        [
            "10:1: regions: no material for cement; every region needs one",
            "14:3: regions.cemnt: the geometry (cylinders) has no region 'cemnt'; "
            "it has stem, cement, bone; did you mean 'cement'?",
        ],
    ),
    "unknown interface": (
        [("cement_bone: {", "bone_cement: {")],
        [
            "27:3: interfaces.bone_cement: the geometry (cylinders) has no interface "
            "'bone_cement'; "
            "it has stem_cement, cement_bone"
        ],
    ),
    "unknown boundary of a support": (
        [("boundary: bone_surface", "boundary: bone_surfaces")],
        [
            "29:23: supports.base.boundary: the geometry (cylinders) has no boundary "
            "'bone_surfaces'; "
            "it has stem_top, stem_bottom, cement_top, cement_bottom, bone_top, bone_bottom, top, "
            "bottom, bone_surface; did you mean 'bone_surface'?"
        ],
    ),
    "unknown boundary of a load": (
        [("boundary: stem_top", "boundary: stem_trunnion")],
        ["33:5: loads.push.boundary: the geometry (cylinders) has no boundary 'stem_trunnion'"],
    ),
    "boundary of another sector": (
        [("boundary: bone_surface", "boundary: symmetry_x")],
        ["29:23: supports.base.boundary: the geometry (cylinders) has no boundary 'symmetry_x'"],
    ),
    "history too short": (
        [("history: [0.5, 1]", "history: [1]")],
        [
            "35:5: loads.push.history: has 1 values; expected 2, one for the end of each stage "
            "(press_fit, push_in)"
        ],
    ),
    "gap history too long": (
        [("gap: -0.01 mm", "gap: -0.01 mm\n    gap_history: [1, 1, 1]")],
        ["27:5: interfaces.stem_cement.gap_history: has 3 values; expected 2"],
    ),
    "history not a list": (
        [("history: [0.5, 1]", "history: 1")],
        ["35:5: loads.push.history: 1 is not a list"],
    ),
    "two stages of a name": (
        [("- name: push_in", "- name: press_fit")],
        ["38:5: stages[1].name: 'press_fit' is the name of an earlier stage too; expected another"],
    ),
    "no stages": (
        [
            ("stages:\n  - name: press_fit\n  - name: push_in\n", "stages: []\n"),
            ("    history: [0.5, 1]\n", ""),
        ],
        ["35:1: stages: is empty; expected at least one stage"],
    ),
    "nothing holds the model": (
        [("supports:\n  base: {kind: fixed, boundary: bone_surface}\n", "")],
        ["1:1: supports: nothing holds the model; expected a support"],
    ),
    "nothing holds the model along two axes": (
        [("kind: fixed,", "kind: roller, axis: z,")],
        ["28:1: supports: nothing holds the model along x and y; expected a support"],
    ),
    "unknown axis": (
        [("kind: fixed,", "kind: roller, axis: w,")],
        ["29:24: supports.base.axis: 'w' is not one of x, y, z"],
    ),
    "displacement of nothing": (
        [("kind: fixed,", "kind: displacement,")],
        ["29:3: supports.base: prescribes nothing; expected at least one of x, y, z"],
    ),
    "foundation without stiffness": (
        [("kind: fixed,", "kind: foundation, stiffness: 0 MPa/mm,")],
        ["29:28: supports.base.stiffness: is zero along every axis"],
    ),
    "force of two components": (
        [("[0 N, 0 N, -100 N]", "[0 N, -100 N]")],
        ["34:5: loads.push.force: has 2 values; expected three, e.g. [0 N, 0 N, -1800 N]"],
    ),
    "force that is no vector": (
        [("[0 N, 0 N, -100 N]", "-100 N")],
        ["34:5: loads.push.force: '-100 N' is not a list of three values"],
    ),
    "unit behind a list without quotes": (
        [("[0 N, 0 N, -100 N]", "[0, 0, -100] N")],
        [
            f"34:25: {SYNTAX}: expected <block end>, but found '<scalar>'; a list with "
            "one unit needs quotes"
        ],
    ),
    "named point of another geometry": (
        [("history: [0.5, 1]", "at: head_centre")],
        [
            "35:5: loads.push.at: 'head_centre' is not a point; expected [x, y, z] lengths "
            "(this geometry names no points)"
        ],
    ),
    "gap that is no expression": (
        [("gap: -0.01 mm", "gap: import os")],
        [
            "26:5: interfaces.stem_cement.gap: 'import os' is not an expression in x, y, "
            "z: invalid syntax"
        ],
    ),
    "gap that reaches for Python": (
        [("gap: -0.01 mm", "gap: x.__class__")],
        [
            "26:5: interfaces.stem_cement.gap: 'x.__class__' is not allowed in an "
            "expression; allowed are"
        ],
    ),
    "gap with unknown name": (
        [("gap: -0.01 mm", "gap: 0.01 * w")],
        ["26:5: interfaces.stem_cement.gap: 'w' is not one of x, y, z, pi"],
    ),
    "displacement that is no expression": (
        [("kind: fixed,", "kind: displacement, z: 0 mm, x: 0.01 * w,")],
        [
            "29:39: supports.base.x: 'w' is not one of x, y, z, pi; expected a length such as "
            "'0.05 mm' or an expression in x, y, z (mm) that gives mm"
        ],
    ),
    "displacement without unit": (
        [("kind: fixed,", "kind: displacement, z: '0.1',")],
        ["29:30: supports.base.z: '0.1' needs a unit, e.g. '0.1 mm'"],
    ),
    "force density that is no expression": (
        [("loads:\n", "loads:\n  g: {kind: body_force, density: [0 N/mm^3, x +, z]}\n")],
        ["31:45: loads.g.density[1]: 'x +' is not an expression in x, y, z: invalid syntax"],
    ),
    "force densities in one text": (
        [("loads:\n", "loads:\n  g: {kind: body_force, density: '[x, hypot(x, y), 0]'}\n")],
        ["31:25: loads.g.density[2]: '0' needs a unit, e.g. '0 N/mm^3'"],
    ),
    "two rigid regions in contact": (
        [
            ("    youngs_modulus: 110 GPa\n    poisson_ratio: 0.3\n", "    rigid: true\n"),
            ("cement: {youngs_modulus: 2.2 GPa, poisson_ratio: 0.3}", "cement: {rigid: true}"),
        ],
        [
            "22:3: interfaces.stem_cement: contact between rigid regions (cement and stem); "
            "one side has to be elastic"
        ],
    ),
    "rigid and elastic at once": (
        [("    poisson_ratio: 0.3\n  cement", "    rigid: true\n  cement")],
        ["12:5: regions.stem.youngs_modulus: unknown key; allowed: rigid"],
    ),
    "rigid false": (
        [("cement: {youngs_modulus: 2.2 GPa, poisson_ratio: 0.3}", "cement: {rigid: false}")],
        ["14:12: regions.cement.rigid: false is not true; an elastic region has"],
    ),
    "vanishing stem": (
        [("length: 20 mm", "length: 20 mm\n  taper: 40 deg")],
        ["8:3: geometry.taper: makes the stem vanish at an end; expected a smaller angle"],
    ),
    "angle without unit of angle": (
        [("length: 20 mm", "length: 20 mm\n  taper: 5 percent")],
        ["8:3: geometry.taper: '5 percent' is a plain number; expected an angle such as '1.5 deg'"],
    ),
    "unknown sector": (
        [("length: 20 mm", "length: 20 mm\n  sector: third")],
        ["8:3: geometry.sector: 'third' is not one of full, half, quarter"],
    ),
    "section that is no mapping": (
        [("mesh:\n  size: 2 mm\n", "mesh: 2 mm\n")],
        ["8:1: mesh: '2 mm' is not a mapping; expected keys size, far_size, order, curved"],
    ),
    "table that is no mapping": (
        [("supports:\n  base: {kind: fixed, boundary: bone_surface}\n", "supports: fixed\n")],
        ["28:1: supports: 'fixed' is not a mapping of names to values"],
    ),
    "entry that is no mapping": (
        [("cement_bone: {kind: bonded}", "cement_bone: bonded")],
        [
            "27:3: interfaces.cement_bone: 'bonded' is not a mapping; expected one with "
            "kind: bonded | "
        ],
    ),
    "title that is no text": ([("title: press", "title: 7")], ["1:1: title: 7 is not text"]),
    "name that is no name": (
        [("push:\n", "'push it':\n")],
        ["31:3: loads.push it: 'push it' is not a name; expected letters, digits, _ and -"],
    ),
    "PETSc option with a dash": (
        [("tolerance: 1e-10", "petsc: {-ksp_type: cg}")],
        ["40:11: solver.petsc.-ksp_type: write the option without the dash: ksp_type"],
    ),
    "unknown linear solver": (
        [("tolerance: 1e-10", "linear: lu")],
        ["40:3: solver.linear: 'lu' is not one of auto, direct, multigrid"],
    ),
    "tab": (
        [("  kind: cylinders", "\tkind: cylinders")],
        [f"3:1: {SYNTAX}: found character '\\t'"],
    ),
    "open bracket": (
        [("[0.5, 1]", "[0.5, 1")],
        [f"36:7: {SYNTAX}: expected ',' or ']', but got"],
    ),
    "unknown alias": (
        [("length: 20 mm", "length: *l")],
        [f"7:11: {SYNTAX}: found undefined alias 'l'"],
    ),
    "foreign tag": (
        [("length: 20 mm", "length: !!python/name:os.system 20")],
        ["7:11: the tag tag:yaml.org,2002:python/name:os.system has no meaning here"],
    ),
    "alias inside itself": (
        [("title: press", "title: &t [*t]")],
        ["1:8: too many or too deeply nested values"],
    ),
    "two documents": (
        [("solver:", "---\nsolver:")],
        [f"39:1: {SYNTAX}: but found another document"],
    ),
    "list for a mapping": ([(GOOD, "- a\n")], ["1:1: expected a mapping with geometry"]),
    "empty": ([(GOOD, "")], ["1:1: the file is empty; expected a mapping with geometry"]),
    "only a comment": ([(GOOD, "# nothing\n")], ["1:1: the file is empty"]),
    "control character": (
        [("press", "pr\0ss")],
        [f"1:10: {SYNTAX}: a control character is not allowed"],
    ),
    "many at once": (
        [
            ("length: 20 mm", "lenght: 20 mm"),
            ("size: 2 mm", "size: 2"),
            ("poisson_ratio: 0.3\n", "poisson_ratio: 0.6\n"),
            ("kind: bonded", "kind: glued"),
            ("[0.5, 1]", "[1]"),
        ],
        [
            "2:1: geometry: 'length' is missing",
            "7:3: geometry.lenght: unknown key",
            "9:3: mesh.size: 2 needs a unit",
            "13:5: regions.stem.poisson_ratio: the stiffness is not positive definite",
            "27:17: interfaces.cement_bone.kind: 'glued'",
            "35:5: loads.push.history: has 1 values; expected 2",
        ],
    ),
}


NO_HEAT = [
    (
        HOT[HOT.index("regions:") : HOT.index("interfaces:")],
        "regions:\n  stem: {rigid: true}\n  cement: {youngs_modulus: 2.2 GPa, poisson_ratio: 0.3}\n"
        "  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}\n",
    ),
]
NOWHERE = "no region conducts heat; expected `thermal` in every region"
CONDUCTORS = [
    ("    rigid: true\n", "    kind: conductor\n"),
    ("    youngs_modulus: 2.2 GPa\n    poisson_ratio: 0.3\n", "    kind: conductor\n"),
    ("      thermal_expansion: 80e-6 1/K\n", ""),
    ("    youngs_modulus: 17 GPa\n    poisson_ratio: 0.3\n", "    kind: conductor\n"),
]
SOFT = HOT[HOT.index("  stem_cement:\n") : HOT.index("  cement_bone:")]
HELD = HOT[HOT.index("supports:") : HOT.index("heat:")]
HOT_TABLE: dict[str, tuple[list[tuple[str, str]], list[str]]] = {
    "temperature without unit": (
        [("initial_temperature: 37 degC", "initial_temperature: 37")],
        ["44:7: regions.bone.thermal.initial_temperature: 37 needs a unit, e.g. '37 degC'"],
    ),
    "temperature in coulomb": (
        [("initial_temperature: 37 degC", "initial_temperature: 37 C")],
        [
            "44:7: regions.bone.thermal.initial_temperature: '37 C' is not a temperature; did "
            "you mean '37 degC'?"
        ],
    ),
    "temperature below absolute zero": (
        [("initial_temperature: 37 degC", "initial_temperature: -300 degC")],
        ["44:7: regions.bone.thermal.initial_temperature: '-300 degC' is not above absolute zero"],
    ),
    "temperature below absolute zero in a condition": (
        [
            (
                "boundary: bone_surface, temperature: 37 degC",
                "boundary: bone_surface, temperature: -1 K",
            )
        ],
        ["63:56: heat.outside.temperature: '-1 K' is not above absolute zero"],
    ),
    "difference for a temperature": (
        [("initial_temperature: 37 degC", "initial_temperature: 37 delta_degC")],
        ["44:7: regions.bone.thermal.initial_temperature: '37 delta_degC' is a difference of"],
    ),
    "temperature for a difference": (
        [("tolerance: 1e-3 K", "tolerance: 1 degC")],
        [
            "68:8: time.tolerance: '1 degC' is a temperature; expected a difference of "
            "temperatures such as '1 K'"
        ],
    ),
    "tolerance of nothing": (
        [("tolerance: 1e-3 K", "tolerance: 0 K")],
        ["68:8: time.tolerance: '0 K' must be positive"],
    ),
    "conductivity of another dimension": (
        [("0.2 W/(m K)", "0.2 W/(m^2 K)")],
        [
            "20:7: regions.cement.thermal.conductivity: '0.2 W/(m^2 K)' is a conductance per "
            "area; expected a conductivity such as '0.2 W/(m K)'"
        ],
    ),
    "activation energy per mass": (
        [("62866 J/mol", "62866 J/kg")],
        [
            "29:11: regions.cement.thermal.cure.kinetics.activation_energy: '62866 J/kg' is an "
            "energy per mass; expected an energy per amount of substance"
        ],
    ),
    "expansion as a rate": (
        [("80e-6 1/K", "80e-6 1/s")],
        [
            "24:7: regions.cement.thermal.thermal_expansion: '80e-6 1/s' is a rate; expected an "
            "expansion per temperature such as '80e-6 1/K'"
        ],
    ),
    "no conductivity": (
        [("      conductivity: 0.2 W/(m K)\n", "")],
        [
            "19:5: regions.cement.thermal: 'conductivity' is missing; expected conductivity, or "
            "axial_conductivity and transverse_conductivity"
        ],
    ),
    "half a conductivity": (
        [("      transverse_conductivity: 0.5 W/(m K)\n", "")],
        [
            "38:5: regions.bone.thermal: 'transverse_conductivity' is missing; expected "
            "conductivity, or"
        ],
    ),
    "conductivity twice": (
        [("axial_conductivity: 0.6", "conductivity: 0.6")],
        [
            "40:7: regions.bone.thermal.transverse_conductivity: transverse_conductivity beside "
            "conductivity"
        ],
    ),
    "fibre for nothing": (
        [("conductivity: 0.2 W/(m K)", "conductivity: 0.2 W/(m K)\n      fibre: [1, 0, 0]")],
        ["21:7: regions.cement.thermal.fibre: the conductivity is the same in all directions"],
    ),
    "two fibres": (
        [
            (
                "    youngs_modulus: 17 GPa\n    poisson_ratio: 0.3\n",
                "    kind: transversely_isotropic\n    axial_youngs_modulus: 17 GPa\n    "
                "transverse_youngs_modulus: 11.5 GPa\n    axial_poisson_ratio: 0.31\n    "
                "transverse_poisson_ratio: 0.51\n    axial_shear_modulus: 3.3 GPa\n",
            )
        ],
        ["45:7: regions.bone.thermal.fibre: the region has a fibre of its own"],
    ),
    "missing density": (
        [("      density: 1200 kg/m^3\n", "")],
        ["19:5: regions.cement.thermal: 'density' is missing; expected: mass per volume"],
    ),
    "unknown thermal key": (
        [("specific_heat: 1450", "heat_capacity: 1450")],
        [
            "19:5: regions.cement.thermal: 'specific_heat' is missing",
            "22:7: regions.cement.thermal.heat_capacity: unknown key; allowed: conductivity, "
            "axial_conductivity",
        ],
    ),
    "unknown key of kinetics": (
        [("m: 0.98", "o: 0.98")],
        [
            "26:9: regions.cement.thermal.cure.kinetics: 'm' is missing; expected: exponent of "
            "the degree",
            "30:11: regions.cement.thermal.cure.kinetics.o: unknown key; allowed: kind, "
            "rate_constant, activation_energy, m, n, limit",
        ],
    ),
    "unknown kinetics": (
        [("kind: autocatalytic", "kind: catalytic")],
        [
            "27:11: regions.cement.thermal.cure.kinetics.kind: 'catalytic' is not one of "
            "autocatalytic, prescribed; did you mean 'autocatalytic'?"
        ],
    ),
    "rigid region that expands": (
        [
            (
                "initial_temperature: 22 degC\n  cement",
                "initial_temperature: 22 degC\n      thermal_expansion: 14e-6 1/K\n  cement",
            )
        ],
        [
            "16:7: regions.stem.thermal.thermal_expansion: a rigid region does not deform; "
            "expected an elastic region"
        ],
    ),
    "rigid region that sets": (
        [
            ("    youngs_modulus: 2.2 GPa\n    poisson_ratio: 0.3\n", "    rigid: true\n"),
            ("      thermal_expansion: 80e-6 1/K\n", ""),
        ],
        [
            "23:7: regions.cement.thermal.cure: a rigid region does not deform; expected an "
            "elastic region",
        ],
    ),
    "reference for nothing": (
        [
            (
                "initial_temperature: 37 degC",
                "initial_temperature: 37 degC\n      reference_temperature: 20 degC",
            )
        ],
        [
            "45:7: regions.bone.thermal.reference_temperature: nothing expands; expected "
            "thermal_expansion"
        ],
    ),
    "reference of what sets": (
        [
            (
                "thermal_expansion: 80e-6 1/K",
                "thermal_expansion: 80e-6 1/K\n      reference_temperature: 20 degC",
            )
        ],
        [
            "25:7: regions.cement.thermal.reference_temperature: strains of a region that cures "
            "count from"
        ],
    ),
    "cure that never starts": (
        [("gel: 0.85", "initial: 0")],
        ["34:9: regions.cement.thermal.cure.initial: never starts from 0 where m > 0"],
    ),
    "cure that is over": (
        [("gel: 0.85", "initial: 1")],
        ["34:9: regions.cement.thermal.cure.initial: 1 must be below 1"],
    ),
    "gel above the limit": (
        [("0.9], [100 degC, 1]", "0.6], [100 degC, 0.8]")],
        ["34:9: regions.cement.thermal.cure.gel: is above the largest limit of the kinetics, 0.8"],
    ),
    "limit above one": (
        [("[100 degC, 1]", "[100 degC, 1.1]")],
        ["32:46: regions.cement.thermal.cure.kinetics.limit[1][1]: 1.1 must be at most 1"],
    ),
    "limit that falls back": (
        [("[100 degC, 1]", "[10 degC, 1]")],
        [
            "32:35: regions.cement.thermal.cure.kinetics.limit[1]: its temperature is not above "
            "that of the pair before"
        ],
    ),
    "limit of three": (
        [("[100 degC, 1]", "[100 degC, 1, 1]")],
        [
            "32:35: regions.cement.thermal.cure.kinetics.limit[1]: has 3 values; expected a pair "
            "such as [20 degC, 0.8]"
        ],
    ),
    "clock that does not run": (
        [
            (
                HOT[HOT.index("          kind: auto") : HOT.index("        heat: 1.55")],
                "          kind: prescribed\n          rate: [[0 s, 0], [300 s, 0]]\n",
            )
        ],
        [
            "28:11: regions.cement.thermal.cure.kinetics.rate: nothing happens; expected at "
            "least two pairs"
        ],
    ),
    "negative heat of reaction": (
        [("1.55e8 J/m^3", "-1.55e8 J/m^3")],
        ["33:9: regions.cement.thermal.cure.heat: '-1.55e8 J/m^3' must not be negative"],
    ),
    "one region without heat": (
        [(HOT[HOT.index("    thermal:\n      conductivity: 14.8") : HOT.index("  cement:\n")], "")],
        [
            "9:3: regions.stem: 'thermal' is missing; expected in every region or in none, like "
            "cement and bone"
        ],
    ),
    "heat in nothing": (
        NO_HEAT,
        [
            f"16:5: interfaces.stem_cement.conductance: {NOWHERE}",
            f"17:5: interfaces.stem_cement.friction_heating: {NOWHERE}",
            f"18:31: interfaces.cement_bone.conductance: {NOWHERE}",
            f"22:1: heat: {NOWHERE}",
            f"33:21: stages[0].duration: nothing takes time: {NOWHERE}",
            f"35:1: time: {NOWHERE}",
        ],
    ),
    "conductor beside solids": (
        [("    rigid: true\n", "    kind: conductor\n")],
        [
            "9:3: regions.stem: a conductor beside solids (cement, bone); expected conductors "
            "only, or none"
        ],
    ),
    "conductors that touch": (
        CONDUCTORS,
        [
            "43:3: interfaces.stem_cement: every region is a conductor: nothing can part; "
            "expected kind: bonded",
            "50:3: supports.base: every region is a conductor: nothing can move",
            "51:3: supports.hold: every region is a conductor: nothing can move",
            "64:5: stages[1]: nothing happens in it; expected a duration, or steady: true",
        ],
    ),
    "conductor that expands": (
        [CONDUCTORS[1], (SOFT, ""), (HELD, "")],
        ["23:7: regions.cement.thermal.thermal_expansion: a conductor does not deform"],
    ),
    "conductor without heat": (
        [(HOT[HOT.index("    rigid") : HOT.index("  cement:\n")], "    kind: conductor\n")],
        ["9:3: regions.stem: 'thermal' is missing; expected: conduction of heat"],
    ),
    "conductance of another dimension": (
        [("1000 W/(m^2 K)", "1000 W/(m K)")],
        [
            "51:31: interfaces.cement_bone.conductance: '1000 W/(m K)' is a conductivity; "
            "expected a conductance per area"
        ],
    ),
    "conductance that is no word": (
        [("1000 W/(m^2 K)", "perfekt")],
        [
            "51:31: interfaces.cement_bone.conductance: 'perfekt' is not a conductance; expected "
            "perfect, a value"
        ],
    ),
    "conductance by something else": (
        [("{kind: pressure, open", "{kind: gap, open")],
        [
            "49:19: interfaces.stem_cement.conductance.kind: 'gap' is not pressure; expected "
            "perfect, a value"
        ],
    ),
    "conductance with a cap below": (
        [("MPa)}", "MPa), cap: 10 W/(m^2 K)}")],
        ["49:88: interfaces.stem_cement.conductance.cap: is below `open`"],
    ),
    "conductance by pressure where there is none": (
        [
            (
                "conductance: 1000 W/(m^2 K)",
                "conductance: {kind: pressure, open: 0 W/(m^2 K), per_pressure: 1 W/(m^2 K MPa)}",
            )
        ],
        [
            "51:31: interfaces.cement_bone.conductance: a bonded interface has no contact "
            "pressure; expected kind: contact or penalty"
        ],
    ),
    "friction heat where nothing rubs": (
        [("1000 W/(m^2 K)", "1000 W/(m^2 K), friction_heating: 0.5")],
        ["51:60: interfaces.cement_bone.friction_heating: unknown key; allowed: kind, conductance"],
    ),
    "friction heat without friction": (
        [("friction_coefficient: 0.4", "friction_coefficient: 0")],
        ["50:5: interfaces.stem_cement.friction_heating: there is no friction"],
    ),
    "more than all friction heat": (
        [("friction_heating: effusivity", "friction_heating: 1.1")],
        ["50:5: interfaces.stem_cement.friction_heating: 1.1 must be at most 1"],
    ),
    "friction heat by another word": (
        [("friction_heating: effusivity", "friction_heating: even")],
        [
            "50:5: interfaces.stem_cement.friction_heating: 'even' is not effusivity or a number "
            "from 0 to 1"
        ],
    ),
    "unknown kind of heat": (
        [("kind: perfusion", "kind: perfussion")],
        [
            "57:5: heat.blood.kind: 'perfussion' is not one of temperature, flux, convection, "
            "source, perfusion; did you mean 'perfusion'?"
        ],
    ),
    "unknown region of heat": (
        [("regions: [bone]", "regions: [bones]")],
        [
            "58:15: heat.blood.regions[0]: the geometry (cylinders) has no region 'bones'; it "
            "has stem, cement, bone; did you mean 'bone'?"
        ],
    ),
    "unknown boundary of heat": (
        [("kind: flux, boundary: stem_top", "kind: flux, boundary: stem_trunnion")],
        ["64:22: heat.lamp.boundary: the geometry (cylinders) has no boundary 'stem_trunnion'"],
    ),
    "temperature nowhere": (
        [("boundary: bone_surface, temperature", "temperature")],
        ["63:3: heat.outside: expected either boundary or regions"],
    ),
    "temperature twice": (
        [("temperature: 37 degC}", "temperature: 37 degC, course: [[0 s, 37 degC]]}")],
        ["63:3: heat.outside: expected either temperature or course"],
    ),
    "course of temperatures without units": (
        [("temperature: 37 degC}", "course: [[0 s, 1], [10 s, 30 degC]]}")],
        ["63:71: heat.outside.course[0][1]: 1 needs a unit, e.g. '1 degC'"],
    ),
    "course that goes back": (
        [("[10 s, 0]", "[0 s, 0]")],
        ["64:78: heat.lamp.course[1]: its time is not above that of the pair before"],
    ),
    "course before the start": (
        [("[0 s, 1]", "[-1 s, 1]")],
        ["64:69: heat.lamp.course[0][0]: '-1 s' must not be negative"],
    ),
    "course of nothing": (
        [("[[0 s, 1], [10 s, 0]]", "[]")],
        ["64:59: heat.lamp.course: is empty; expected at least one pair"],
    ),
    "no time": (
        [(", duration: 1 hour", "")],
        [
            "65:1: stages: heat has no time to flow; expected a duration, or steady: true, in "
            "some stage"
        ],
    ),
    "steady and a duration": (
        [("duration: 1 hour", "duration: 1 hour, steady: true")],
        ["66:21: stages[0].duration: a steady stage takes no `duration`"],
    ),
    "cure in a steady stage": (
        [("duration: 1 hour", "steady: true")],
        ["66:21: stages[0].steady: cement sets with time; expected a duration"],
    ),
    "steady stage without a sink": (
        [
            ("name: rest", "name: rest, steady: true"),
            (HOT[HOT.index("  blood:") : HOT.index("  lamp")], ""),
            (HOT[HOT.index("      cure:") : HOT.index("  bone:\n")], ""),
        ],
        [
            "49:18: stages[1].steady: nothing settles the temperature; expected heat of kind "
            "temperature, convection or perfusion"
        ],
    ),
    "duration of a length": (
        [("1 hour", "1 m")],
        ["66:21: stages[0].duration: '1 m' is a length; expected a time such as '600 s'"],
    ),
    "unknown stage of a support": (
        [("stages: [setting]", "stages: [seting]")],
        [
            "54:52: supports.hold.stages[0]: 'seting' is not one of setting, rest; did you mean "
            "'setting'?"
        ],
    ),
    "support in no stage": (
        [("stages: [setting]", "stages: []")],
        ["54:43: supports.hold.stages: is empty; expected names of stages"],
    ),
    "nothing holds in one stage": (
        [
            (
                "  base: {kind: fixed, boundary: bone_surface}\n",
                "  base: {kind: roller, boundary: bone_surface, axis: z}\n",
            )
        ],
        [
            "52:1: supports: nothing holds the model along x and y in stage 'rest'; expected a "
            "support"
        ],
    ),
    "unknown time stepping": (
        [("tolerance: 1e-3 K", "method: sdirk2")],
        [
            "68:8: time.method: 'sdirk2' is not one of sdirk4, backward_euler; did you mean "
            "'sdirk4'?"
        ],
    ),
    "probe in an unknown region": (
        [("region: cement", "region: marrow")],
        [
            "70:42: output.probes.middle.region: the geometry (cylinders) has no region "
            "'marrow'; it has stem, cement, bone"
        ],
    ),
    "probe that is no point": (
        [('{at: "[9, 0, 10] mm", region: cement}', "[9 mm, 0 mm]")],
        ["70:12: output.probes.middle.at: has 2 values; expected three"],
    ),
}


def edit(edits: list[tuple[str, str]], text: str = GOOD) -> str:
    """A good file with edits, each of which has to apply."""
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def complaints(path: Path, overrides: list[str] | None = None) -> list[str]:
    with pytest.raises(InputError) as caught:
        load(path, overrides or [])
    return caught.value.messages


def test_good_file_is_good(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(GOOD)
    assert load(path).config.title == "press"
    path.write_text(HOT)
    assert load(path).config.conducts


@pytest.mark.parametrize("name", [*TABLE, *HOT_TABLE])
def test_complaint(name: str, tmp_path: Path) -> None:
    edits, expected = (TABLE | HOT_TABLE)[name]
    path = tmp_path / "case.yaml"
    path.write_text(edit(edits, HOT if name in HOT_TABLE else GOOD))
    messages = complaints(path)
    assert len(messages) == len(expected), messages
    for message, start in zip(messages, expected, strict=True):
        assert message.startswith(f"{path}:{start}")
        assert "\n" not in message
        assert "=" not in message.replace(" >= ", "").split(": ")[1], (
            "a class name leaked into the path"
        )


def test_table_is_large_enough() -> None:
    assert not TABLE.keys() & HOT_TABLE.keys()
    assert sum(len(expected) for _, expected in (TABLE | HOT_TABLE).values()) >= 130


OVERRIDES = [
    ("mesh.size=3", "--set mesh.size: 3 needs a unit, e.g. '3 mm'"),
    (
        "mesh.sise=3 mm",
        "--set mesh.sise: unknown key; allowed: size, far_size, order, curved; did you",
    ),
    ("mesh", "--set mesh: expected KEY=VALUE"),
    ("=3", "--set : expected KEY=VALUE"),
    ("mesh..size=3", "--set mesh..size: expected KEY=VALUE"),
    ("title.x=3", "--set title.x: title is a single value: it has no 'x'"),
    ("stages[7].name=a", "--set stages[7].name: stages has entries 0 to 1, not '7'"),
    (
        "stages.1.increments=0",
        "--set stages.1.increments: stages[1].increments: 0 must be at least 1",
    ),
    (
        "interfaces.stem_cement.kind=glued",
        "--set interfaces.stem_cement.kind: 'glued' is not one of",
    ),
    ("regions.stem={rigid: 1}", "--set regions.stem: regions.stem.rigid: 1 is not true"),
    ("loads.push.force=[0, 0", "--set loads.push.force: not valid YAML: "),
    (
        "mesh.size={a: 1, a: 2}",
        "--set mesh.size: mesh.size.a: this key stands here twice; keep one",
    ),
]


@pytest.mark.parametrize(("override", "expected"), OVERRIDES)
def test_override(override: str, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(GOOD)
    (message,) = complaints(path, [override])
    assert message.startswith(expected)


def test_errors_of_file_and_overrides_come_together(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(edit([("length: 20 mm", "length: 20")]))
    messages = complaints(path, ["mesh.size=3", "nonsense"])
    assert len(messages) == 3
    assert messages[0].startswith(f"{path}:7:3: ")
    assert all(m.startswith("--set ") for m in messages[1:])


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    assert complaints(tmp_path / "none.yaml") == [f"{tmp_path}/none.yaml: no such file"]
    assert complaints(tmp_path) == [f"{tmp_path}: is a folder; expected a YAML file"]
    latin = tmp_path / "latin.yaml"
    latin.write_bytes(b"title: a\n# \xb5m\n")
    assert complaints(latin) == [f"{latin}:2:3: not UTF-8 text (byte 0xb5)"]
    assert complaints(latin / "below")[0].startswith(f"{latin}/below: cannot be read: Not a dir")


def test_aliases_cannot_blow_up(tmp_path: Path) -> None:
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 12)]
    path = tmp_path / "bomb.yaml"
    path.write_text("\n".join(rows))
    assert "too many or too deeply nested values" in complaints(path)[0]
    path.write_text("a: " + "[" * 3000)
    assert "not valid YAML" in complaints(path)[0]


MESHES = [
    ("nonsense", "not a gmsh .msh file"),
    ("$MeshFormat\n2.1 0 8\n", "not of .msh format 2.2 or 4.1"),
    ("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n", "names no region"),
]


@pytest.mark.parametrize(("content", "expected"), MESHES)
def test_mesh_file(content: str, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text("geometry:\n  kind: file\n  path: a.msh\nmesh: {size: 1 mm}\nregions: {}\n")
    assert any(f"{path}:3:3: geometry.path: no such file: " in m for m in complaints(path))
    (tmp_path / "a.msh").write_text(content)
    (message,) = (m for m in complaints(path) if "geometry" in m)
    assert message.startswith(f"{path}:3:3: geometry.path: ")
    assert expected in message


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("~nosuchuser/a.msh", "'~nosuchuser/a.msh': Could not determine home directory"),
        ("a" * 300 + ".msh", "cannot be read: File name too long"),
        ('"a\\0.msh"', "no such file"),
    ],
)
def test_mesh_file_that_cannot_be(
    name: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(
        f"geometry:\n  kind: file\n  path: {name}\nmesh: {{size: 1 mm}}\nregions: {{}}\n"
    )
    assert main(["check", str(path)]) == 2
    err = capsys.readouterr().err
    assert f"{path}:3:3: geometry.path: " in err and words in err


def test_mesh_file_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, mesh = tmp_path / "case.yaml", tmp_path / "a.msh"
    path.write_text("geometry:\n  kind: file\n  path: a.msh\nmesh: {size: 1 mm}\nregions: {}\n")
    mesh.touch()
    opens = Path.open

    def refuses(self: Path, *how: Any, **more: Any) -> Any:
        if self == mesh:
            raise PermissionError(errno.EACCES, "Permission denied")
        return opens(self, *how, **more)

    monkeypatch.setattr(Path, "open", refuses)
    (message,) = (m for m in complaints(path) if "geometry" in m)
    assert message.startswith(f"{path}:3:3: geometry.path: ")
    assert message.endswith("cannot be read: Permission denied")


@pytest.mark.parametrize(
    ("edits", "words"),
    [
        ({}, ""),
        # 0.5 - 49 * 2.4 / 98 and 1 - 89 * 2 / 58 mm are left at the shoulder.
        ({"stem_half_depth": 1.2, "stem_corner_radius": 0.5, "stem_tip_corner_radius": 2.9,
          "stem_section_z": -20.0},
         "stem_corner_radius: at the shoulder, z = 29 mm, it has become -0.7 mm"),
        ({"stem_half_depth": 1.0, "stem_corner_radius": 0.5, "stem_section_z": -60.0},
         "stem_half_depth: at the shoulder, z = 29 mm, it has become -2.07 mm"),
        ({"stem_section_z": -115.0, "cement_thickness": 1.0, "plug_length": 20.0},
         "stem_half_width: at the end of the plug, z = -138 mm, it has become"),
    ],
)  # fmt: skip
def test_sections_of_the_stem_at_all_levels_that_are_used(
    edits: dict[str, float], words: str
) -> None:
    """Straight lines through the sections at -118 mm and at ``stem_section_z``."""
    given = {key: f"{value} mm" for key, value in edits.items()}
    if not words:
        Femur.model_validate(given)
        return
    with pytest.raises(ValidationError) as caught:
        Femur.model_validate(given)
    (entry,) = caught.value.errors(include_url=False)
    assert f"{entry['ctx']['at'][0]}: {entry['msg']}".startswith(words)


def test_names_of_a_mesh_file(tmp_path: Path) -> None:
    (tmp_path / "a.msh").write_text(
        '$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n3\n2 7 "bottom"\n3 1 "rock"\n'
        '3 2 "soil"\n$EndPhysicalNames\n'
    )
    path = tmp_path / "case.yaml"
    path.write_text(
        "geometry:\n  kind: file\n  path: a.msh\n  interfaces:\n    joint: [rock, [soli]]\n"
        "mesh: {size: 1 mm}\nregions: {rock: {rigid: true, tissue: other}}\nsupports:\n"
        "  base: {kind: fixed, boundary: botom}\n"
    )
    (message,) = complaints(path)
    assert message == (
        f"{path}:5:19: geometry.interfaces.joint[1]: 'soli' is not one of rock, soil; "
        "did you mean 'soil'?"
    )
    path.write_text(path.read_text().replace("soli", "soil"))
    messages = complaints(path)
    assert [re.sub(r".*?yaml:", "", m).split(";")[0] for m in messages] == [
        "7:1: regions: no material for soil",
        "9:23: supports.base.boundary: the geometry (file) has no boundary 'botom'",
    ]


def test_command_says_it_once_and_exits_with_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(edit([("110 GPa", "110 mm")]))
    for command in ("check", "run", "mesh"):
        assert main([command, str(path)]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith(f"{path}:12:5: regions.stem.youngs_modulus: ")
        assert err.count("\n") == 1
    # The other ranks of an MPI job keep quiet and leave with the same code.
    monkeypatch.setenv("OMPI_COMM_WORLD_RANK", "1")
    monkeypatch.setattr(cli, "GRACE", 0.0)
    assert main(["run", str(path)]) == 2
    assert capsys.readouterr() == ("", "")


COMMAND_LINES = [
    ([], "the following arguments are required: COMMAND"),
    (["chek", "x"], "invalid choice: 'chek'"),
    (["check"], "the following arguments are required: CASE"),
    (["check", "none.yaml"], "none.yaml: no such file"),
    (["check", "none.yaml", "--colour"], "unrecognized arguments: --colour"),
    (["check", "none.yaml", "--", "-log_view"], "takes no PETSc options"),
    (["run", "none.yaml", "-n", "zero"], "-n: 'zero' is not a number of ranks"),
    (["run", "none.yaml", "-o"], "expected one argument"),
]


@pytest.mark.parametrize(("arguments", "expected"), COMMAND_LINES)
def test_command_line(
    arguments: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert expected in err
    assert err.count("\n") == 1


def test_run_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(GOOD)
    full = tmp_path / "full"
    full.mkdir()
    (full / "fields.vtkhdf").touch()
    cases = [
        (full, "is not empty; choose another folder, or --force to replace the results"),
        (path, "is a file; expected a folder"),
        (path / "below", "a folder above it is a file"),
        (Path("/proc/nowhere"), "cannot be made or read: "),
    ]
    for folder, expected in cases:
        assert main(["run", str(path), "-o", str(folder)]) == 2
        assert capsys.readouterr().err.startswith(f"-o {folder}: {expected}")


def test_module_exits_with_the_code(tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "mantle", "run", str(tmp_path / "none.yaml")],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 2
    assert result.stderr == f"{tmp_path}/none.yaml: no such file\n"
    assert result.stdout == ""


@pytest.mark.parallel
def test_one_rank_of_a_plain_mpirun_speaks_and_all_exit_with_2(tmp_path: Path) -> None:
    if shutil.which("mpirun") is None:
        pytest.skip("no mpirun")
    path = tmp_path / "case.yaml"
    path.write_text(edit([("110 GPa", "110 mm")]))
    result = subprocess.run(
        ["mpirun", "-n", "3", sys.executable, "-m", "mantle", "run", str(path)],
        env=ranks.environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 2
    assert result.stderr.count("regions.stem.youngs_modulus: '110 mm' is a length") == 1
    assert result.stdout == ""


@pytest.mark.parametrize("wrong", ["stem_length: 250 mm", "stem_legth: 147 mm", "neck_angle: 2"])
def test_a_wrong_geometry_is_the_only_error(wrong: str, tmp_path: Path) -> None:
    """Which points it would name is not known: that loads act there is no error."""
    path = tmp_path / "case.yaml"
    text = (Path(__file__).parents[2] / "configs/stance.yaml").read_text()
    path.write_text(text.replace("  kind: femur\n", f"  kind: femur\n  {wrong}\n"))
    (message,) = complaints(path)
    assert "geometry." in message
    # What else is wrong with such a load is told all the same.
    path.write_text(path.read_text().replace("at: psoas", "at: psoas\n    histori: [1]"))
    assert ["geometry." in m or "histori" in m for m in complaints(path)] == [True, True]
