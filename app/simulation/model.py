"""A case ready to be solved: mesh, mechanics, heat, and the numbers of its states."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

import meshes
from app.case.case import Case
from app.case.summary import Summary, merge
from app.foundation.collective import agree, on_root
from app.foundation.errors import ConvergenceError, GeometryError, InputError
from app.foundation.verdict import Verdict
from app.mechanics.contact import TrialState
from app.mechanics.predictors import Predictor, WarmStart
from app.mechanics.problem import Problem
from app.numerics import lifetime
from app.numerics.newton import Solver
from app.numerics.numerical_errors import as_convergence_errors
from app.results.balance import Balance
from app.results.bond_forces import BondForces
from app.results.field_output import FieldGroup, HeatFields, MechanicalFields
from app.results.gauges import ProbedMechanics
from app.results.hip import StemMotion, by_zone, of_collar, of_femur
from app.results.interface_numbers import ContactSamples
from app.results.records import Record, RecordedModel, records
from app.results.stresses import Stresses
from app.results.surface_parts import Surface, in_parts
from app.scene.scene import Scene, Stage, build_scene
from app.simulation.steppers import steppers
from app.simulation.thermal_model import ThermalModel
from app.soundness import cost, floating_bodies_of_state, memory, well_posedness
from app.stepping.coarse_start import CoarseStart
from app.stepping.heat_state import HeatStep
from app.stepping.heat_steps import OnHeat
from app.stepping.load_steps import Effort, LoadStep, LoadStepper, OnStep
from app.stepping.stages import Analysis, SolverSettings, assemble
from app.system import folders
from app.system.timing import Timing
from meshes.data import MeshData
from meshes.distribute import TaggedMesh, distribute
from meshes.geometry import is_hip
from meshes.gruen import Zones
from meshes.pieces import MeshPieces

log = logging.getLogger("mantle")

# Number of unknowns from which on a start from a coarse model pays. Between 18,000 and 40,000 it
# changes the time by less than 10 % if a run converges without it. Else it halves the time: 7
# iterations, not 25.
LARGE = 20_000
# Mesh size of the coarse model over that of the run.
COARSENING_OF_START = 2.0
# Tolerance of the coarse model, relative to the forces: far below its discretization error.
TOLERANCE = 1e-4


def _nothing(*_: object) -> None:
    """Ignore the arguments."""


class Mechanical:
    """Mechanics of a model, or of successive models that differ in loads and laws alone.

    Attributes:
        warm_start: States of earlier models, as starts of a solve.
        zones: Zones of a hip, with the parts of interfaces in `surfaces`; None for other models.
        stem: Motion of the implant.
    """

    saved = ("problem", "solver", "stem")

    def __init__(self, problem: Problem, solver: Solver, case: Case) -> None:
        geometry = case.geometry
        self.problem = problem
        self.solver = solver
        self.zones = None
        self.stem = StemMotion(problem, case)
        self.surfaces: list[Surface] = []
        depth = None
        if is_hip(geometry):
            self.zones = zones = Zones(geometry)
            depth = zones.depth
            if problem.contact:
                surface = problem.contact.points.surface
                levels = zones.borders(surface.x)
                names = [c.name for c in problem.scene.parting_interfaces]
                self.surfaces = in_parts(surface, names, levels)
        self.stresses = Stresses(problem, geometry.is_around_z, depth)
        borders = self.zones.borders if self.zones else None
        self.bonds = BondForces(problem, self.stresses, borders)
        self.warm_start = WarmStart(problem, solver)
        self._balance: Balance | None = None

    def begin(self) -> None:
        """Begin another case with problem and solver at rest; collective."""
        self.warm_start.begin()
        self.stem.at_insertion = {}

    def restored(self) -> None:
        """Fill the unknowns with the restored displacement and jumps; collective."""
        self.problem.restore_unknowns(*self.solver.u_and_q())
        self.stresses.follow_density()

    def balance(self, about: NDArray[np.float64]) -> Balance:
        """Balances of the model at rest, with moments about a fixed point (3,) [mm]; collective."""
        if self._balance is None:
            self._balance = Balance(self.problem, about)
        else:
            self._balance.begin()
        return self._balance


class Model:
    """A case ready to be solved; made on all ranks.

    Args:
        options: Raw PETSc options from the command line.
        stop: Returns the name of a pending stop signal, or "".
        reuse: An earlier model with the same options. Its meshes are reused, and its mechanics
            too if loads and laws alone differ; these are then at rest again.
        judged: True to check whether the case is well-posed on its mesh.
        runs: Number of runs that may follow on the same matrices, this one included.

    Attributes:
        case: Case of the model.
        analysis: Problem, solver and heat of its scene.
        mechanics: Mechanics with its published numbers, if a region deforms.
        thermal: Heat with its published numbers, if regions conduct.
        records: Records that other packages add to the mechanics, by name.
        probes: Displacements of points and numbers of strain gauges, if a region deforms.
        mesh_hash: Digest of the mesh.
        parts: Connected pieces of the mesh, on rank 0.
        notes: Warnings about the case on its mesh.

    Raises:
        InputError: The case cannot be solved.
    """

    def __init__(
        self,
        case: Case,
        comm: MPI.Comm,
        options: dict[str, str],
        timing: Timing,
        stop: Callable[[], str],
        reuse: Model | None = None,
        judged: bool = True,
        runs: int = 1,
    ) -> None:
        self._runs = runs
        self.case, self._timing = case, timing
        self.options, self.stop = options, stop
        # Shared by all successive models.
        self._other_models: list[Model] = reuse._other_models if reuse is not None else []
        timing.about |= cost.phases(case)
        with timing.phase("mesh"):
            self.tagged, self.mesh_hash, self.parts = self._mesh(comm)
            # Checked first, because matrices of unheld bodies cannot be factorized.
            parts = self.parts if judged else None
            self.notes = (
                on_root(comm, lambda: parts and well_posedness.check_on_mesh(case, parts)) or []
            )
        with timing.phase("assemble"):
            self.scene: Scene = build_scene(case)
            self.analysis, self.mechanics = self._assemble()
            self.records: dict[str, Record] = {}
            self.probes: ProbedMechanics | None = None
            heating, mechanics = self.analysis.heating, self.mechanics
            if mechanics:
                self.probes = ProbedMechanics(case, mechanics.problem)
                heat = heating.system if heating else None
                self.records = records(
                    case,
                    RecordedModel(mechanics.problem, mechanics.stresses, mechanics.zones, heat),
                )
            self.thermal: ThermalModel | None = None
            if self.analysis.heating:
                self.thermal = ThermalModel(case, self.analysis.heating)
        self._other_models[:] = [
            model for model in self._other_models if not self.deforms_like(model.case)
        ] + [self]

    def _mesh(self, comm: MPI.Comm) -> tuple[TaggedMesh, str, MeshPieces | None]:
        """The mesh, its digest, and its connected pieces on rank 0; collective."""
        case = self.case
        for model in self._other_models:
            if (model.case.geometry, model.case.mesh) == (case.geometry, case.mesh):
                return model.tagged, model.mesh_hash, model.parts

        def build() -> tuple[MeshData, str, MeshPieces]:
            data = meshes.build(case.geometry, case.mesh, folders.cache("meshes"))
            return data, _mesh_hash(data), well_posedness.mesh_parts(case, data)

        data, digest, parts = on_root(comm, build, share=False) or (None, "", None)
        digest = comm.bcast(digest)
        tagged = distribute(data, comm)
        lifetime.register(tagged.mesh)
        return tagged, digest, parts

    def deforms_like(self, case: Case) -> bool:
        """Return True if a case differs from this one in loads and laws alone."""
        return _data_of_matrices(self.case) == _data_of_matrices(case)

    def _assemble(self) -> tuple[Analysis, Mechanical | None]:
        """Return the analysis and its mechanics, on earlier matrices where they fit; collective."""
        case, same_stiffness = self.case, None
        earlier: Model | None = None
        for model in self._other_models if not self.scene.stiffness_varies else ():
            mechanics = model.mechanics
            if mechanics is None or mechanics.problem.body_forms.density_regions:
                continue
            if model.deforms_like(case):
                earlier = model
                break
            has_same_stiffness = _data_of_stiffness(model.case) == _data_of_stiffness(case)
            if has_same_stiffness and all(
                support.stages is None for support in self.scene.supports
            ):
                same_stiffness = same_stiffness or mechanics.problem
        options = case.solver
        settings = SolverSettings(
            tolerance=options.tolerance,
            max_iterations=options.max_iterations,
            linear=options.linear,
            petsc={**options.petsc, **self.options},
            augmentation_factor=options.augmentation_factor,
            solves=self._runs * cost.contact_solves(case),
            # The same on all ranks: machines may differ, and it decides on the solver.
            memory=self.tagged.mesh.comm.allreduce(memory.available_memory(), MPI.MIN),
            stop=self.stop,
        )
        place = self.scene, self.tagged, settings, self._timing
        if earlier is not None and earlier.mechanics is not None:
            analysis = assemble(*place, reuse=earlier.analysis)
            earlier.mechanics.begin()
            return analysis, earlier.mechanics
        analysis = assemble(*place, same_stiffness=same_stiffness)
        if analysis.problem is None or analysis.solver is None:
            return analysis, None
        return analysis, Mechanical(analysis.problem, analysis.solver, case)

    def sizes(self) -> dict[str, int]:
        """Unknowns by block."""
        sizes = dict(self.thermal.heating.solver.block_sizes) if self.thermal else {}
        return sizes | (self.mechanics.solver.block_sizes if self.mechanics else {})

    def field_groups(self) -> list[FieldGroup]:
        """Groups of fields to be written: mechanics, heat."""
        field_groups: list[FieldGroup] = []
        mechanics = self.mechanics
        if mechanics:
            field_groups.append(
                MechanicalFields(
                    mechanics.problem, mechanics.stresses, self.records.values(), mechanics.bonds
                )
            )
        t = self.thermal
        if t:
            field_groups.append(HeatFields(t.heating, t.record, self.case.geometry.interface_sides))
        return field_groups

    def run(
        self,
        on_step: OnStep = _nothing,
        on_heat: OnHeat = _nothing,
        on_trouble: Callable[[str], None] = _nothing,
        on_stage: Callable[[Stage], None] = _nothing,
        checkpoint_point: Callable[[int], None] = _nothing,
        resume: Callable[[], int] = lambda: 0,
    ) -> Effort:
        """Solve all stages; return the counts of steps and iterations; collective.

        Args:
            on_step: Called after each step of the mechanics.
            on_heat: Called after each step of the heat and of its mechanics.
            on_trouble: Called with the next remedy when a step fails.
            on_stage: Called before each stage.
            checkpoint_point: Called with the number of the stage wherever `saved_parts` may be
                saved.
            resume: Called first. It may restore a state, and returns the stage to begin with.

        Raises:
            ConvergenceError: As `Steppers.run`.
        """
        for record in self.records.values():
            on_step = record.before(on_step)
            on_stage = record.before_stage(on_stage)
        t = self.thermal

        def on_accepted(step: LoadStep, heat_step: HeatStep) -> None:
            if t:
                t.update(heat_step)
            on_heat(step, heat_step)

        mechanics, stages = self.mechanics, self.scene.stages
        if mechanics:
            on_step = mechanics.stem.before(on_step)
        predictors = self._predictors(mechanics) if mechanics else ()
        self._steppers = self.analysis.steppers(on_step, on_accepted, on_trouble, predictors)
        if self._steppers.load:
            self._steppers.extension_steppers = steppers(stages, self, self._steppers.load)
        return self._steppers.run(stages, on_stage, checkpoint_point, resume())

    def return_to_last_step(self) -> None:
        """Return to the last committed step after one that failed or was stopped; collective.

        Only what results read is returned: no further step can follow.
        """
        if self.mechanics:
            self.mechanics.problem.return_to_kept()
        if self.thermal:
            self.thermal.return_to_last_step()

    def saved_parts(self) -> dict[str, object]:
        """All state on which later steps depend, in the order in which it is restored."""
        saved_objects: dict[str, object] = {
            **self.records,
            "mechanics": self.mechanics,
            "thermal": self.thermal,
            "heat_stepper": self._steppers.heat,
            "load_stepper": self._steppers.load,
            "creep_stepper": self._steppers.creep,
        }
        return saved_objects | {
            f"stepper of {key}": s for key, s in self._steppers.extension_steppers.items()
        }

    def _predictors(self, mechanics: Mechanical) -> tuple[Predictor, ...]:
        """States of earlier models and, for large models, a start from a coarse one."""
        if (
            mechanics.problem.contact is None
            or self.scene.conductors
            or mechanics.solver.linear.exact
        ):
            return (mechanics.warm_start,)
        case = coarse_case(self.case, sum(mechanics.solver.block_sizes.values()))
        if case is None:
            return (mechanics.warm_start,)
        return mechanics.warm_start, CoarseStart(
            mechanics.problem, mechanics.solver, lambda: self._coarse_stepper(case)
        )

    def separate_model(self, case: Case, purpose: str) -> Model:
        """A model of another case that shares nothing with this one; timed as ``purpose``."""
        comm, timing = self.tagged.mesh.comm, self._timing.of(purpose)
        return Model(case, comm, self.options, timing, self.stop, judged=False)

    def _coarse_stepper(self, case: Case) -> LoadStepper:
        """Load stepper of the coarse model; itself with a coarse start if it is large."""
        coarse = self._other_model(case, self._timing.of("coarse model"))
        assert coarse.mechanics is not None
        predictors = coarse._predictors(coarse.mechanics)
        stepper = coarse.analysis.load_stepper(on_trouble=log.debug, predictors=predictors)
        assert stepper is not None
        return stepper

    def _other_model(self, case: Case, timing: Timing) -> Model:
        comm = self.tagged.mesh.comm
        return Model(case, comm, self.options, timing, self.stop, self, judged=False)

    # Published numbers of the last committed state

    def numbers(self, samples: ContactSamples | None) -> Summary:
        """All published numbers; collective."""
        numbers: Summary = {"interfaces": {}, "regions": {}, "stem": {}, "probes": {}}
        mechanics = self.mechanics
        if mechanics:
            elastic = mechanics.problem.scene.elastic
            if samples is not None:
                numbers["interfaces"] = {name: dict(q) for name, q in samples.numbers.items()}
            numbers["regions"] = {
                e.region: mechanics.stresses.numbers_of_region(e.region) for e in elastic
            }
            bonds = mechanics.bonds.numbers()
            if bonds:
                numbers["bonds"] = bonds
            creep = mechanics.problem.creep
            if creep:
                numbers["creep"] = {creep.measure: creep.elapsed, "dissipation": creep.dissipated}
            numbers["stem"] = mechanics.stem(self.case.side) | of_collar(
                self.case, numbers["interfaces"]
            )
            femur = of_femur(mechanics.problem, self.case)
            if femur:
                numbers["femur"] = femur
            if self.probes:
                numbers["probes"] = self.probes.numbers()
        t = self.thermal
        if t:
            numbers["thermal"] = {**t.record.summary(), "flows": t.flows}
            if t.cure:
                numbers["cure"] = t.cure.summary()
        self._add_places(numbers, samples)
        for record in self.records.values():
            merge(numbers, record.numbers())
        return numbers

    def warnings_of_floating_bodies(self) -> list[Verdict]:
        """Warnings on bodies that nothing holds in the last state; collective."""
        mechanics = self.mechanics
        if mechanics is None or mechanics.problem.contact is None:
            return []
        return floating_bodies_of_state.warnings_of_floating_bodies(
            mechanics.problem, mechanics.problem.trial(*mechanics.solver.u_and_q())
        )

    def _add_places(self, numbers: Summary, samples: ContactSamples | None) -> None:
        """Add numbers that some geometries have: mantle, layers, Gruen zones; collective."""
        notes = self.tagged.notes
        if "mantle" in notes:
            numbers["mantle"] = notes["mantle"]
        if "layers" in notes:
            numbers["layers"] = notes["layers"]
        if "cortex_min" in notes:
            numbers["cortex_min"] = notes["cortex_min"]
        mechanics = self.mechanics
        if mechanics and mechanics.zones:
            numbers["gruen"] = by_zone(
                mechanics.problem, mechanics.stresses, samples, mechanics.zones
            )

    def numbers_of_companion(self, case: Case) -> Summary:
        """Solve a companion case; return its numbers; collective.

        Raises:
            ConvergenceError: It cannot be solved.
        """
        with as_convergence_errors():
            return self._numbers_of_companion(case)

    def _numbers_of_companion(self, case: Case) -> Summary:
        other_model = self._other_model(case, Timing("estimating errors"))
        last_trial: TrialState | None = None
        mechanics = other_model.mechanics

        def keep(step: LoadStep, trial: TrialState | None) -> None:
            nonlocal last_trial
            last_trial = trial

        other_model.run(keep, on_trouble=lambda message: log.debug("     %s", message))
        samples = (
            ContactSamples(mechanics.problem, last_trial, None, mechanics.surfaces)
            if mechanics and last_trial
            else None
        )
        return other_model.numbers(samples)

    def numbers_or_reason(self, case: Case) -> tuple[Summary | None, str]:
        """Numbers of a companion case, or None and why it cannot be solved; collective."""
        try:
            return self.numbers_of_companion(case), ""
        except (ConvergenceError, GeometryError, InputError) as failure:
            agree(self.tagged.mesh.comm, failure)
            return None, str(failure).splitlines()[0]


def coarse_case(case: Case, unknowns: int) -> Case | None:
    """The case on a coarser mesh, else at first order; None if the case is small."""
    if unknowns < LARGE:
        return None
    mesh, solver = case.mesh, case.solver
    if COARSENING_OF_START * mesh.size <= case.geometry.coarsest_size:
        mesh = mesh.coarser(COARSENING_OF_START)
    elif mesh.order > 1:
        mesh = mesh.model_copy(update={"order": 1})
    else:
        return None
    solver = solver.model_copy(update={"tolerance": max(TOLERANCE, solver.tolerance)})
    return case.model_copy(update={"mesh": mesh, "solver": solver})


def _data_of_stiffness(case: Case) -> tuple[object, ...]:
    """All data of a case on which the stiffness of the bonded model and its solver depend."""
    solver = case.solver.model_copy(update={"augmentation_factor": 1.0, "tolerance": 0.0})
    stages = [stage.name for stage in case.stages]
    motions = [(m.region, m.boundary, m.about, m.translation) for m in case.motions.values()]
    bodies = case.geometry, case.mesh, case.regions, case.supports
    return *bodies, motions, case.sliding_boundaries, solver, stages


def _data_of_matrices(case: Case) -> tuple[object, ...]:
    """All data of a case on which its matrices and compiled forms depend."""
    loads = [(name, load.form_key) for name, load in case.loads.items()]
    parting = [name for name, law in case.interfaces.items() if law.can_part]
    return *_data_of_stiffness(case), loads, parting


def _mesh_hash(data: MeshData) -> str:
    digest = hashlib.sha256()
    for array in (data.points, data.cells, data.cell_tags, data.facets, data.facet_tags):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
