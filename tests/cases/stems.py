"""Stems in cement and bone, and a peg in its socket, for several tests."""

from __future__ import annotations

# A square peg in a square socket: points with one, two and three faces.
PEG = """
mesh: {order: 1, size: 1.5 mm}
regions:
  socket: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3, tissue: other}
  peg: {youngs_modulus: 300 MPa, poisson_ratio: 0.3, tissue: other}
interfaces:
  peg_socket: {kind: contact, friction_coefficient: 0.4, gap: -2e-3 mm}
supports:
  floor: {kind: fixed, boundary: floor}
loads:
  push: {kind: force, boundary: head, force: [0 N, 0 N, -30 N]}
  x: {kind: force, boundary: head, force: [12 N, 0 N, 0 N]}
  y: {kind: force, boundary: head, force: [0 N, 12 N, 0 N]}
"""
# The peg, 4 x 4 x 5 mm, 3 mm deep in its socket.
PEG_MESH = """
SetFactory("OpenCASCADE");
DefineConstant[ size = 1.5 ];
Box(1) = {-4, -4, 0, 8, 8, 6};
Box(2) = {-2, -2, 3, 4, 4, 3};
BooleanDifference(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
Box(4) = {-2, -2, 3, 4, 4, 5};
Coherence;
Physical Volume("socket") = {3};
Physical Volume("peg") = {4};
Physical Surface("floor") = Surface In BoundingBox {-5, -5, -0.1, 5, 5, 0.1};
Physical Surface("head") = Surface In BoundingBox {-5, -5, 7.9, 5, 5, 8.1};
"""
# A stem that is pushed into creeping cement, unloaded for the rest: friction, contact and history.
CREEPING = """
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 4 mm, bone_thickness: 5 mm,
  length: 24 mm, taper: 1.5 deg, sector: quarter}
mesh: {order: 2, size: 6 mm, far_size: 8 mm}
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
  cement: {material: creeping_PMMA}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0.1}
supports:
  symmetry_x: {kind: roller, boundary: symmetry_x, axis: x}
  symmetry_y: {kind: roller, boundary: symmetry_y, axis: y}
  table: {kind: roller, boundary: bone_bottom, axis: z}
loads:
  push: {kind: force, boundary: stem_top, force: [0 N, 0 N, -400 N], history: [1, 1, 0.1, 1]}
stages:
  - {name: stand}
  - {name: walk, creep_cycles: 1.0e+5}
  - {name: rest, creep_cycles: 1.0e+5}
  - {name: stance}
output: {fields: false}
"""
# A quarter of a stem, pressed in and then pushed: three planes of symmetry.
QUARTER = """
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 4 mm, bone_thickness: 6 mm,
           length: 15 mm, taper: 1.5 deg, sector: quarter}
mesh: {size: 5 mm}
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2.2 GPa, poisson_ratio: 0.3}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0.2, gap: -0.01 mm, gap_history: [1, 1]}
  cement_bone: {kind: contact, friction_coefficient: 0.3}
supports:
  symmetry_x: {kind: roller, boundary: symmetry_x, axis: x}
  symmetry_y: {kind: roller, boundary: symmetry_y, axis: y}
  under_bone: {kind: roller, boundary: bone_bottom, axis: z}
  under_cement: {kind: roller, boundary: cement_bottom, axis: z}
loads:
  push: {kind: force, boundary: stem_top, force: [0 N, 0 N, -900 N], history: [0, 1]}
stages:
  - {name: press_fit}
  - {name: push_in, increments: 2}
solver: {tolerance: 1e-12}
"""
# Cement that sets between bone and a stem, held by hand at first: all conditions of heat.
SETTING = """
geometry: {kind: cylinders, stem_radius: 6 mm, cement_thickness: 4 mm, bone_thickness: 5 mm,
  length: 6 mm}
mesh: {size: 3 mm, far_size: 3 mm, order: 1}
regions:
  stem:
    youngs_modulus: 200 GPa
    poisson_ratio: 0.3
    thermal: {conductivity: 14.8 W/(m K), density: 4430 kg/m^3, specific_heat: 843 J/(kg K),
      initial_temperature: 37 degC}
  cement:
    youngs_modulus: 2200 MPa
    poisson_ratio: 0.3
    thermal: {conductivity: 0.2 W/(m K), density: 1200 kg/m^3, specific_heat: 1460 J/(kg K),
      initial_temperature: 75 degC, thermal_expansion: 80e-6 1/K, cure: {kinetics: {
      kind: autocatalytic, rate_constant: 2.6397e8 1/s, activation_energy: 62866 J/mol, m: 0.98,
      n: 1.064}, heat: 1.55e8 J/m^3, initial: 0.05, gel: 0.2, shrinkage: 0.003}}
  bone:
    youngs_modulus: 17 GPa
    poisson_ratio: 0.3
    thermal: {axial_conductivity: 0.6 W/(m K), transverse_conductivity: 0.4 W/(m K),
      density: 2000 kg/m^3, specific_heat: 1260 J/(kg K), initial_temperature: 37 degC,
      thermal_expansion: 10e-6 1/K}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0.3, gap: -0.02 mm, gap_history: [1, 1],
    conductance: 300 W/(m^2 K)}
  cement_bone: {kind: bonded, conductance: 300 W/(m^2 K)}
heat:
  outer: {kind: temperature, boundary: bone_surface, temperature: 37 degC}
  low: {kind: temperature, boundary: cement_bottom, temperature: 333 + x}
  under: {kind: temperature, boundary: bone_bottom, temperature: 40 degC}
  lamp: {kind: flux, boundary: stem_top, flux: 0.1 + 0.01 * x}
  air: {kind: convection, boundary: bone_top, coefficient: 200 W/(m^2 K), ambient: 20 degC}
  blood: {kind: perfusion, regions: [bone], rate: 0.002 1/s, blood_density: 1050 kg/m^3,
    blood_specific_heat: 3800 J/(kg K), temperature: 37 degC}
  ohmic: {kind: source, regions: [stem], density: 0.01 * z}
supports:
  outer: {kind: fixed, boundary: bone_surface}
  hand: {kind: fixed, boundary: stem_top, stages: [set]}
loads:
  push: {kind: force, boundary: stem_bottom, force: [20 N, 10 N, -40 N], history: [0, 1]}
stages:
  - {name: set, duration: 80 s, increments: 4, adaptive: false}
  - {name: push}
output: {fields: false}
"""
