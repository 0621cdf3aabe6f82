"""Content of ``summary.json``: the results of a run as plain data.

Lengths are in mm, forces in N, stresses in MPa, energies in N mm, angles in degrees, temperatures
in degC and times in s; section ``units`` repeats this. `case.quantities.TABLE` has the unit of
each number in sections of type `Numbers`. A section is missing if a run has nothing for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypedDict, cast

# Numbers of one interface, region or body by key: numbers, vectors (3,), counts, and the numbers of
# its parts (`quantities.PARTS`). None stands for a number that is not known. The estimated error of
# a number X is X_error. Other packages add numbers.
Numbers = dict[str, Any]
# Levels of temperature of regions, over which their time and volume are known [degC].
TEMPERATURE_LEVELS = (47, 50, 56)


class ThermalNumbers(TypedDict, total=False):
    """Numbers of heat.

    Attributes:
        regions: Temperatures, doses and dead bone, by region.
        interfaces: Temperatures of both sides, jump and flux, by interface.
        flows: Heat per time at the end [mW]: ``into`` the model by condition, and ``through``
            interfaces of finite conductance.
        note: Reason why doses are missing.
    """

    regions: dict[str, Numbers]
    interfaces: dict[str, Numbers]
    flows: dict[str, dict[str, float]]
    note: str


class Zone(TypedDict, total=False):
    """Numbers of a Gruen zone.

    Attributes:
        strain_energy_density: Mean by region of bone [MPa].
        strain_energy_density_error: Its estimated error [MPa].
        volume: Volume by region of bone [mm3].
        interfaces: Motion and tractions in the zone, by interface.
    """

    strain_energy_density: dict[str, float]
    strain_energy_density_error: dict[str, float]
    volume: dict[str, float]
    interfaces: dict[str, Numbers]


class MantleNumbers(TypedDict, total=False):
    """Thickness of the cement mantle.

    Attributes:
        thickness: Statistics of the thickness on the stem [mm].
        volume: Volume of the cement [mm3].
        plug_volume: Part of it below the flanks of the stem [mm3].
        gruen: Statistics of the thickness by Gruen zone [mm].
        cortex_min: Smallest thickness of the cortex [mm].
    """

    thickness: dict[str, float]
    volume: float
    plug_volume: float
    gruen: dict[str, dict[str, float]]
    cortex_min: float


class StageCycles(TypedDict, total=False):
    """Numbers of a stage with cycles, by ``stem`` or interface.

    Attributes:
        permanent: Motions in the last valley [mm, deg].
        inducible: Changes of these motions from the last valley to the last peak [mm, deg].
        areas: Areas of inducible motion above the bounds of ingrowth, by press fit [mm2].
        change: With finite sliding, relative differences of the last two cycles.
        dissipation: Work of friction from peak to peak [N mm].
        trend: Trend of the dissipation: ``vanishes``, ``stays``, ``falls`` or ``grows``.
    """

    permanent: dict[str, dict[str, float]]
    inducible: dict[str, dict[str, float]]
    areas: dict[str, dict[str, float]]
    change: dict[str, dict[str, float]]
    dissipation: list[float]
    trend: str


class SolverNumbers(TypedDict, total=False):
    """Size and effort of a run.

    Attributes:
        dofs: Number of unknowns.
        blocks: Number of unknowns by block.
        steps: Number of load and time steps.
        rejected_steps: Number of rejected steps; None if the run has not ended.
        newton_iterations: Number of Newton iterations.
        linear_iterations: Number of Krylov iterations.
        augmentation: Augmentation of each interface [MPa/mm].
        condition: Condition number of the last Jacobian.
        ranks: Number of ranks.
    """

    dofs: int
    blocks: dict[str, int]
    steps: int
    rejected_steps: int | None
    newton_iterations: int
    linear_iterations: int
    augmentation: dict[str, float]
    condition: float
    ranks: int


class Memory(TypedDict):
    """Peak of the memory: ``peak`` of all ranks [MB], ``per_unknown`` [kB]."""

    peak: float
    per_unknown: float


class EstimatedErrors(TypedDict):
    """Estimate of errors.

    Attributes:
        companions: Companion runs that were solved, in words.
        failed: Companion runs that failed, in words.
        share_within_error: Share of such numbers whose true error is below the estimate [-].
        sources: Sources of error: ``mesh and step``, ``time step`` or ``load step``.
        unsettled: Peaks that still change, by full name: pairs of mesh size [mm] and value, the
            finest mesh first.
    """

    companions: list[str]
    failed: list[str]
    share_within_error: float
    sources: str
    unsettled: dict[str, list[list[float]]]


class BoneInfluence(TypedDict):
    """Changes of main numbers by other bone where none was measured.

    Attributes:
        mesh_size: Size of the cells of all runs [mm].
        changes: Number with the bone of the run and with another one, by the name of the number,
            by what differs in the bone.
        sentence: The largest changes, in words.
    """

    mesh_size: float
    changes: dict[str, dict[str, list[float]]]
    sentence: str


class Summary(TypedDict, total=False):
    """Sections of ``summary.json`` that the core writes.

    Records of other packages add sections and numbers (`results.records.Record.numbers`);
    `added_section` returns such a section.

    Attributes:
        status: ``converged``, ``do not use``, ``not converged`` or ``stopped``.
        title: Title of the case.
        units: Units by dimension.
        time: Time of the last step: stage k runs from k to k + 1.
        interfaces: Motion, tractions and states of contact, by interface.
        bonds: Tractions of bonded interfaces, by interface.
        regions: Stresses, by region.
        stem: Motion of the stem relative to the bone.
        femur: Motion of the head, and strains of the cortex.
        mantle: Thickness of the cement mantle.
        layers: Counts and sizes of a layered mesh.
        cortex_min: Smallest thickness of the cortex around a stem without cement [mm].
        gruen: Numbers of each Gruen zone, by its number.
        thermal: Numbers of heat.
        cure: Degrees of cure, by region.
        creep: ``cycles`` or ``time`` [s] of creep, and its ``dissipation`` [N mm].
        cycles: Permanent and inducible motions, by stage.
        section_loads: Loads above cuts of the femur (`case.section_loads.SectionLoad`).
        probes: ``displacement`` (3,) [mm] of each probe; of a strain gauge its mean, the ``strain``
            [-], the ``centre`` (3,) [mm] and the unit vector ``direction`` (3,) of the grid.
        balance: Relative defects of force, moment, energy and heat [-].
        solver: Size and effort.
        timing: Wall time by phase [s].
        cpu: CPU time of all ranks by phase [s].
        memory: Peak of the memory.
        error: Estimate of errors.
        assumed_bone: Changes of main numbers by other bone where none was measured.
        accuracy: Accuracy that was asked for and reached, in words.
        verdicts: Statements on the run (`foundation.verdict.Verdict.record`).
    """

    status: str
    title: str
    units: dict[str, str]
    time: float
    interfaces: dict[str, Numbers]
    bonds: dict[str, Numbers]
    regions: dict[str, Numbers]
    stem: Numbers
    femur: Numbers
    mantle: MantleNumbers
    layers: Numbers
    cortex_min: float
    gruen: dict[str, Zone]
    thermal: ThermalNumbers
    cure: dict[str, Numbers]
    creep: dict[str, float]
    cycles: dict[str, StageCycles]
    section_loads: list[Numbers]
    probes: dict[str, Numbers]
    balance: dict[str, float]
    solver: SolverNumbers
    timing: dict[str, float]
    cpu: dict[str, float]
    memory: Memory
    error: EstimatedErrors
    assumed_bone: BoneInfluence
    accuracy: str
    verdicts: list[dict[str, str]]


def added_section(summary: Summary, name: str) -> Numbers:
    """Return a section that another package adds; empty if it is missing."""
    return cast(Numbers, cast(Numbers, summary).get(name, {}))


def name_of_implant(summary: Summary) -> str:
    """Return ``stem``, or ``implant`` if no region or interface of a run has a stem in its name."""
    owners = [*summary.get("regions", {}), *summary.get("interfaces", {})]
    return "stem" if any("stem" in owner for owner in owners) else "implant"


def merge(summary: Summary, added: Mapping[str, Any]) -> None:
    """Add sections by key, number by number."""
    _merge(cast(Numbers, summary), added)


def _merge(numbers: Numbers, added: Mapping[str, Any]) -> None:
    for key, value in added.items():
        if isinstance(value, Mapping):
            _merge(numbers.setdefault(key, {}), value)
        else:
            numbers[key] = value
