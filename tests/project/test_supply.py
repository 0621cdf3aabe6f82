"""Parts of mantle: complete and bounded dependencies, and the list of all parts."""

from __future__ import annotations

import re
import sys
import tomllib
from importlib import metadata
from importlib.util import find_spec

import pytest
from packaging.requirements import Requirement

from docs import packages
from tests.project.sources import MODULES, ROOT, imported, top

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRA = PROJECT["optional-dependencies"]
# Names of packages whose distributions are called otherwise.
CALLED = {
    "PIL": "pillow",
    "basix": "fenics-basix",
    "dolfinx": "fenics-dolfinx",
    "ffcx": "fenics-ffcx",
    "mpl_toolkits": "matplotlib",
    "pydantic_core": "pydantic",
    "ruamel": "ruamel.yaml",
    "skimage": "scikit-image",
    "ufl": "fenics-ufl",
}
PACKAGES = {"app", "configs", "forms", "mantle", "meshes"}
# Modules that type checkers alone know.
STUBS = {"_typeshed"}


def test_supply_imports_are_dependencies() -> None:
    named = {Requirement(text).name for text in PROJECT["dependencies"]}
    optional = {Requirement(text).name for text in (*EXTRA["many"], *EXTRA["completion"])}
    packages = {top(name) for path in MODULES.values() for name in imported(path)}
    needed = {
        CALLED.get(name, name) for name in packages - {*sys.stdlib_module_names} - PACKAGES - STUBS
    }
    assert needed - optional == named and "snakemake" in optional


@pytest.mark.parametrize(
    "text", [*PROJECT["dependencies"], *(t for e in EXTRA.values() for t in e)]
)
def test_supply_dependencies_have_bounds(text: str) -> None:
    wanted = Requirement(text)
    assert {s.operator for s in wanted.specifier} & {"~=", "==", "<"}, text
    try:
        assert wanted.specifier.contains(metadata.version(wanted.name), prereleases=True)
    except metadata.PackageNotFoundError:
        absent = {"gmsh", "ruff", "argcomplete", "python-gdcm"}
        # One wheel holds these.
        absent |= {"fenics-dolfinx", "petsc4py"} if find_spec("dolfinx_solver") else set()
        assert wanted.name in absent


def test_supply_dolfinx_is_of_a_known_series() -> None:
    """The interface changes with every series; `app.foundation.dolfinx_features` has these."""
    (dolfinx,) = (Requirement(t) for t in PROJECT["dependencies"] if "dolfinx" in t)
    known = [v for v in ("0.8.0", "0.9.5", "0.10.0", "0.11.0", "0.12.0") if v in dolfinx.specifier]
    assert known == ["0.9.5", "0.10.0", "0.11.0"]


def named(requirements: list[str]) -> dict[str, Requirement]:
    return {r.name.lower(): r for r in map(Requirement, requirements)}


def test_supply_wheels_have_allowed_versions() -> None:
    """The wheel of DOLFINx contains PETSc and MPI. The linter is installed apart."""
    brought = {"fenics-dolfinx", "fenics-ufl", "fenics-basix", "fenics-ffcx", "petsc4py", "mpi4py"}
    wheels = named(packages.requirements("wheel"))
    extras = (*EXTRA["many"], *EXTRA["test"], *EXTRA["dicom"])
    wanted = named([*PROJECT["dependencies"], *extras])
    assert wheels.keys() - {"dolfinx-solver-real", "pulp"} == wanted.keys() - brought
    for name in wanted.keys() - brought:
        lowest = next(s.version for s in wheels[name].specifier if s.operator != "<")
        assert lowest in wanted[name].specifier, name
    (dolfinx,) = wheels["dolfinx-solver-real"].specifier
    assert dolfinx.version in wanted["fenics-dolfinx"].specifier


def test_supply_conda_has_the_same_packages() -> None:
    assert (ROOT / "environment.yml").read_text() == packages.environment()
    conda = {re.split("[<>=~]", name)[0] for name in packages.requirements("conda")}
    other = {"snakemake-minimal": "snakemake", "matplotlib-base": "matplotlib"}
    have = {other.get(name, name.removeprefix("python-")) for name in conda}
    wanted = named([*PROJECT["dependencies"], *EXTRA["many"], *EXTRA["test"]]).keys()
    # DOLFINx installs its parts.
    assert wanted - have == {"fenics-ufl", "fenics-basix", "fenics-ffcx"}


@pytest.mark.parametrize("recipe", ["Dockerfile", "mantle.def"])
def test_supply_image_recipes_read_the_list(recipe: str) -> None:
    text = (ROOT / recipe).read_text()
    assert "packages.txt" in text and "python3-" not in text


def test_supply_linter_has_known_digests() -> None:
    """The list of ruff has digests, and mantle installs it with --require-hashes."""
    text = (ROOT / "tests" / "ruff.txt").read_text()
    assert re.findall(r"^ruff\S*", text, re.MULTILINE) == EXTRA["lint"]
    assert len(re.findall(r"--hash=sha256:[0-9a-f]{64}\b", text)) >= 2
    assert "--require-hashes" in (ROOT / "mantle").read_text()


def test_supply_image_base_is_named_by_digest() -> None:
    (base,) = re.findall(r"^ARG BASE=(.*)$", (ROOT / "Dockerfile").read_text(), re.M)
    assert re.fullmatch(r"debian:trixie-slim@sha256:[0-9a-f]{64}", base)
