"""A case made ready to be solved: mesh, mechanics, heat, and what is published of its states."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable
from typing import Any

from mpi4py import MPI

import numpy as np

import meshes
from app.case.case import Case
from app.heat.implicit_step import ImplicitStep
from app.heat.operators import HeatOperators
from app.mechanics.contact import TrialState
from app.mechanics.predictors import Predictor
from app.mechanics.problem import Problem
from app.mechanics.systems import mechanical
from app.numerics.newton import Solver
from app.numerics.system import System
from app.results import gruen, interface_numbers
from app.results.field_output import FieldGroup, HeatFields
from app.results.interface_numbers import ContactSamples
from app.results.mechanical_fields import MechanicalFields
from app.results.run_folder import on_root
from app.results.stem_motion import stem_motion
from app.scene.build import build_scene
from app.scene.scene import Scene, SceneStage
from app.simulation import coarser_case
from app.simulation.mechanical_model import Mechanical
from app.simulation.thermal_model import ThermalModel
from app.soundness import cost, well_posedness
from app.stepping.coarse_start import CoarseModelStart
from app.stepping.coupled_system import CoupledSystem
from app.stepping.heat_state import HeatState, HeatStep
from app.stepping.heat_steps import HeatStepper, OnHeat
from app.stepping.heated_mechanics import SolvedAfterHeat, SolvedWithHeat
from app.stepping.load_steps import LoadStep, LoadStepper, OnStep, Summary
from app.stepping.stages import run_stages
from app.system import folders
from app.system.timing import Timing
from meshes.data import MeshData
from meshes.distribute import TaggedMesh, distribute
from meshes.pieces import Parts

log = logging.getLogger("mantle")


class Model:
    """A case made ready to be solved.

    Attributes:
        scene: What is solved.
        tagged: On what mesh.
        mesh_hash: Digest of that mesh.
        parts: What that mesh consists of, on rank 0.
        mechanics: Its mechanics, if it has any.
        thermal: Its heat, if it has any.
    """

    def __init__(
        self,
        case: Case,
        comm: MPI.Comm,
        options: dict[str, str],
        timing: Timing,
        stop: Callable[[], str],
        kin: list[Model] | None = None,
    ) -> None:
        """Mesh, assemble and set the solvers up; collective.

        Args:
            case: The configuration.
            comm: Communicator.
            options: Raw PETSc options from the command line.
            timing: Where the seconds go.
            stop: Returns the name of a pending stop signal, or "".
            kin: Models before it, with the same options, of which it takes over what it can: their
                meshes, and their mechanics, after which they are of no use. It joins them.
        """
        self._case, self._timing = case, timing
        self.options, self.stop = options, stop
        self._kin = [] if kin is None else kin
        timing.about |= cost.phases(case)
        with timing.phase("mesh"):
            self.tagged, self.mesh_hash, self.parts = self._mesh(comm)
        with timing.phase("assemble"):
            self.scene: Scene = build_scene(case)
            self.mechanics = self._mechanics()
            heating = self._heat()
            self.thermal = (ThermalModel(case, heating),) if heating else ()
        self._kin[:] = [m for m in self._kin if not self.deforms_like(m._case)] + [self]

    def _mesh(self, comm: MPI.Comm) -> tuple[TaggedMesh, str, Parts | None]:
        """The mesh, its digest, and what it consists of, on rank 0; collective."""
        case = self._case
        for model in self._kin:
            if (model._case.geometry, model._case.mesh) == (case.geometry, case.mesh):
                return model.tagged, model.mesh_hash, model.parts
        data = on_root(
            comm,
            lambda: meshes.build(case.geometry, case.mesh, folders.cache("meshes")),
            share=False,
        )
        found = well_posedness.look(case, data) if data is not None else None
        digest = comm.bcast(_mesh_hash(data) if data is not None else "")
        return distribute(data, comm), digest, found

    def judge(self) -> list[str]:
        """Warnings about the case on its mesh; collective.

        Raises:
            InputError: It cannot be solved.
        """
        found = self.parts
        notes = on_root(
            self.tagged.mesh.comm,
            lambda: well_posedness.judge(self._case, found) if found is not None else [],
        )
        return notes or []

    def deforms_like(self, case: Case) -> bool:
        """Whether a case has the matrices of this one, its contacts, and loads in its places."""
        return coarser_case.matrices(self._case) == coarser_case.matrices(case)

    def _solver(self, system: System) -> Solver:
        chosen = self._case.solver
        options = dict(chosen.petsc) | self.options
        return Solver(
            system,
            chosen.tolerance,
            chosen.max_iterations,
            chosen.linear,
            options,
            self._timing,
            self.stop,
        )

    def _mechanics(self) -> tuple[Mechanical, ...]:
        """Problem and solver, where anything deforms."""
        if not self.scene.elastic:
            return ()
        factor = self._case.solver.augmentation_factor
        like: list[Problem] = []
        for model in self._kin if not self.scene.cures else ():
            if model.deforms_like(self._case):
                (m,) = model.mechanics
                m.begin(self.scene, factor, self._case.solver.tolerance)
                return (m,)
            if coarser_case.stiffness(model._case) == coarser_case.stiffness(self._case):
                like += [m.problem for m in model.mechanics]
        if any(support.stages is not None for support in self.scene.supports):
            like.clear()
        timing = self._timing
        problem = Problem(self.scene, self.tagged, factor, timing, *like[:1])
        solver, around_z = self._solver(mechanical(problem)), self._case.geometry.is_around_z
        return (Mechanical(problem, solver, around_z, self._timing),)

    def _heat(self) -> HeatState | None:
        """Heat and what solves it, where anything conducts."""
        if not self.scene.conductors:
            return None
        heat = ImplicitStep(HeatOperators(self.scene, self.tagged, self._timing))
        coupled = None
        if self.scene.coupled:
            mechanics = self.mechanics[0]
            committed = mechanics.solver.blocks()
            coupled = CoupledSystem(self.scene, heat, mechanics.problem, committed)
        return HeatState(self.scene, heat, self._solver(coupled or heat), coupled)

    def sizes(self) -> dict[str, int]:
        """Unknowns by block."""
        parts = [t.heating.solver.block_sizes for t in self.thermal]
        parts += [m.solver.block_sizes for m in self.mechanics]
        return {name: size for part in parts for name, size in part.items()}

    def layers(self) -> list[FieldGroup]:
        """Groups of fields to be written: mechanical, and of heat."""
        sides = self._case.geometry.interface_sides
        return [
            *(MechanicalFields(m.problem, m.stresses) for m in self.mechanics),
            *(HeatFields(t.heating, t.record, sides) for t in self.thermal),
        ]

    def go(
        self,
        on_step: OnStep,
        on_heat: OnHeat,
        on_trouble: Callable[[str], None],
        begin: Callable[[SceneStage], None] = lambda stage: None,
        mark: Callable[[int], None] = lambda k: None,
        resume: Callable[[], int] = lambda: 0,
    ) -> Summary:
        """Solve all stages.

        Args:
            on_step: Called after each step of the mechanics.
            on_heat: Called after each step of the heat, the mechanics having followed.
            on_trouble: Told what is tried when a step fails.
            begin: Called before each stage.
            mark: Called with the number of the stage wherever `saved_parts` may be saved.
            resume: Called first: may take up a state, and gives the stage that it is in.

        Returns:
            What it took.

        Raises:
            ConvergenceError: As `run_stages`.
        """

        def heated(step: LoadStep, accepted: HeatStep) -> None:
            for t in self.thermal:
                t.update(accepted)
            on_heat(step, accepted)

        load_stepper, heat_stepper = None, None
        for m in self.mechanics:
            predictors: tuple[Predictor, ...] = (m.neighbours, *self._nested(m))
            load_stepper = LoadStepper(m.problem, m.solver, on_step, on_trouble, predictors)
        for t in self.thermal:
            beside = self._beside_heat(t.heating, load_stepper)
            heat_stepper = HeatStepper(t.heating, beside, heated, on_trouble)
        self._steppers = load_stepper, heat_stepper
        run_stages(self.scene.stages, load_stepper, heat_stepper, begin, mark, resume())
        total = Summary()
        for part in (load_stepper, heat_stepper):
            if part is not None:
                total.add(part.total)
        return total

    def saved_parts(self) -> dict[str, Any]:
        """All that the steps to come depend on, in the order in which it is restored."""
        load_stepper, heat_stepper = self._steppers
        return {
            "mechanics": self.mechanics,
            "thermal": self.thermal,
            "heat_stepper": heat_stepper,
            "load_stepper": load_stepper,
        }

    def _nested(self, m: Mechanical) -> tuple[CoarseModelStart, ...]:
        """A start from a cheaper model, if that pays."""
        if m.problem.contact is None or self.scene.conductors:
            return ()
        case = coarser_case.cheaper(self._case, sum(m.solver.block_sizes.values()))
        return (
            ()
            if case is None
            else (CoarseModelStart(m.problem, m.solver, lambda: self._cheaper(case)),)
        )

    def _cheaper(self, case: Case) -> LoadStepper:
        """The mechanics of a cheaper model on their way; collective."""
        comm, timing = self.tagged.mesh.comm, self._timing.of("cheaper model")
        other = Model(case, comm, self.options, timing, self.stop, self._kin)
        (m,) = other.mechanics
        predictors: tuple[Predictor, ...] = (m.neighbours, *other._nested(m))
        return LoadStepper(m.problem, m.solver, lambda step, trial: None, log.debug, predictors)

    @staticmethod
    def _beside_heat(
        heating: HeatState, load_stepper: LoadStepper | None
    ) -> SolvedAfterHeat | SolvedWithHeat | None:
        """The mechanics beside the heat: in one system with it, or after it."""
        if load_stepper is None:
            return None
        if heating.coupled is not None:
            return SolvedWithHeat(load_stepper, heating, heating.coupled)
        return SolvedAfterHeat(load_stepper, heating, heating.options.mechanical_step)

    # What is published of the state last committed

    def numbers(self, samples: ContactSamples | None) -> dict[str, Any]:
        """All numbers; collective.

        Args:
            samples: Of the contact points, if there are any.
        """
        numbers: dict[str, Any] = {"interfaces": {}, "regions": {}, "stem": {}}
        for m in self.mechanics:
            elastic = m.problem.scene.elastic
            numbers["interfaces"] = self.interfaces(samples)
            numbers["regions"] = {e.region: m.stresses.region(e.region) for e in elastic}
            if m.bonds:
                numbers["bonds"] = {b.name: b.numbers() for b in m.bonds}
            numbers["stem"] = stem_motion(m.problem, self._case)
        for t in self.thermal:
            numbers["thermal"] = t.record.summary() | {"flows": t.flows}
            for cure in t.cure:
                numbers["cure"] = cure.summary()
        return numbers

    def places(self, samples: ContactSamples | None) -> dict[str, Any]:
        """Numbers that only some geometries have: mantle, layers, Gruen zones; collective."""
        notes = self.tagged.notes
        found = {key: notes[key] for key in ("mantle", "layers") if key in notes}
        for m in self.mechanics:
            if self._case.geometry.has_gruen_zones:
                from meshes.gruen import Zones  # brings scipy, which few runs need

                zones = Zones(self._case.geometry)
                found["gruen"] = gruen.summary(m.problem, m.stresses, samples, zones)
        return found

    def interfaces(self, samples: ContactSamples | None) -> dict[str, dict[str, Any]]:
        """Published numbers of the contact interfaces, by name; collective."""
        if samples is None:
            return {}
        (m,) = self.mechanics
        return {
            c.name: interface_numbers.interface(m.problem, samples, i)
            for i, c in enumerate(self.scene.contacts)
        }

    def relative(self, case: Case) -> dict[str, Any]:
        """Solve another case in the same way; collective."""
        comm, timing = self.tagged.mesh.comm, Timing("estimating errors")
        other = Model(case, comm, self.options, timing, self.stop, self._kin)
        last: list[ContactSamples | None] = [None]

        def keep(step: LoadStep, trial: TrialState | None) -> None:
            if step.time == len(other.scene.stages) and trial is not None:
                last[0] = ContactSamples(other.mechanics[0].problem, trial)

        def trouble(text: str) -> None:
            log.debug("     %s", text)

        other.go(keep, lambda step, accepted: None, trouble)
        return other.numbers(last[0]) | other.places(last[0])


def _mesh_hash(data: MeshData) -> str:
    digest = hashlib.sha256()
    for array in (data.points, data.cells, data.cell_tags, data.facets, data.facet_tags):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
