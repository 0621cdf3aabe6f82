"""Properties of the configuration that hold for all inputs, tried on random ones."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from app.case.case import dump, load, resolve
from app.case.geometries import Blocks
from app.errors import InputError
from app.laws.materials import Isotropic, TransverselyIsotropic
from app.schema import yaml_file
from app.schema.units import Length, Modulus, Stiffness, Temperature

finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
moderate = st.floats(-1e6, 1e6)
positive = st.floats(1e-3, 1e6)
names = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True)
FACTORS = {
    "mm": Fraction(1),
    "um": Fraction(1, 1000),
    "m": Fraction(1000),
    "inch": Fraction(254, 10),
}


# ------------------------------------------------------------------------------------ units


@given(finite, st.sampled_from(sorted(FACTORS)), st.sampled_from(["", " ", "\t"]))
@settings(deadline=None)
def test_conversion_is_rounded_once(value: float, unit: str, space: str) -> None:
    """The result is the float nearest to the exact product of the number as written."""
    text = f"{value!r}{space}{unit}"
    exact = Fraction(repr(value)) * FACTORS[unit]
    try:
        expected = float(exact)
    except OverflowError:
        with pytest.raises(ValidationError, match="not finite"):
            TypeAdapter(Length).validate_python(text)
        return
    assert TypeAdapter(Length).validate_python(text) == expected


@given(finite)
@settings(deadline=None)
def test_internal_unit_changes_nothing(value: float) -> None:
    for kind, unit in ((Length, "mm"), (Modulus, "MPa")):
        adapter = TypeAdapter(kind)
        assert adapter.validate_python(f"{value!r} {unit}") == value
        assert adapter.validate_python(adapter.dump_python(value, mode="json")) == value


@given(st.floats(-math.pi, math.pi))
@settings(deadline=None)
def test_angles_survive_writing(value: float) -> None:
    adapter = TypeAdapter(Blocks.model_fields["tilt"].rebuild_annotation())
    assert adapter.validate_python(adapter.dump_python(value, mode="json")) == value


@given(st.integers(1, 10**6), st.integers(-9, 9))
@settings(deadline=None)
def test_the_unit_it_is_written_in_does_not_matter(number: int, power: int) -> None:
    read = TypeAdapter(Stiffness).validate_python
    results = {
        read(f"{number}e{power} MPa/mm"),
        read(f"{number}e{power + 6} Pa/mm"),
        read(f"{number}e{power - 3} GPa/mm"),
        read(f"{number}e{power} N/mm^3"),
        read(f"{number}e{power} N/mm**2/mm"),
        read(f"{number}e{power + 9} N m^-3"),
    }
    assert len(results) == 1


@given(st.text(max_size=30))
@settings(deadline=None)
def test_any_text_is_a_length_or_a_told_error(text: str) -> None:
    try:
        assert math.isfinite(TypeAdapter(Length).validate_python(text))
    except ValidationError as error:
        assert [e["type"] for e in error.errors()] == ["mantle"]


@given(st.from_regex(r"-?[0-9]{1,3} [a-zµ°*/^() 0-9.-]{0,15}", fullmatch=True))
def test_random_units_are_read_or_refused(text: str) -> None:
    try:
        assert math.isfinite(TypeAdapter(Length).validate_python(text))
    except ValidationError as error:
        assert [e["type"] for e in error.errors()] == ["mantle"]


# -------------------------------------------------------------------------------- materials


def compliance(e_l: float, e_t: float, nu_l: float, nu_t: float, mu_l: float) -> Any:
    """Voigt compliance of a transversely isotropic material with fibre z, shape (6, 6)."""
    s = np.zeros((6, 6))
    s[:2, :2] = [[1 / e_t, -nu_t / e_t], [-nu_t / e_t, 1 / e_t]]
    s[2, :3] = s[:3, 2] = -nu_l / e_l
    s[2, 2] = 1 / e_l
    s[3, 3] = s[4, 4] = 1 / mu_l
    s[5, 5] = 2 * (1 + nu_t) / e_t
    return s


ratios = st.floats(-1.5, 1.5)
moduli = st.floats(0.1, 10.0)


@given(moduli, moduli, ratios, ratios, moduli)
def test_transversely_isotropic_is_accepted_iff_positive_definite(
    e_l: float, e_t: float, nu_l: float, nu_t: float, mu_l: float
) -> None:
    eigenvalues = np.linalg.eigvalsh(compliance(e_l, e_t, nu_l, nu_t, mu_l))
    if abs(eigenvalues).min() < 1e-9 * abs(eigenvalues).max():
        return  # on the limit rounding decides
    values = {
        "kind": "transversely_isotropic",
        "axial_youngs_modulus": f"{e_l!r} GPa",
        "transverse_youngs_modulus": f"{e_t!r} GPa",
        "axial_poisson_ratio": nu_l,
        "transverse_poisson_ratio": nu_t,
        "axial_shear_modulus": f"{mu_l!r} GPa",
    }
    if eigenvalues.min() > 0.0:
        TransverselyIsotropic.model_validate(values)
    else:
        with pytest.raises(ValidationError, match="not positive definite"):
            TransverselyIsotropic.model_validate(values)


@given(st.floats(-10.0, 10.0), st.floats(-2.0, 2.0))
@settings(deadline=None)
def test_isotropic_is_accepted_iff_positive_definite(modulus: float, ratio: float) -> None:
    values = {"youngs_modulus": f"{modulus!r} GPa", "poisson_ratio": ratio}
    if modulus * 1000.0 > 0.0 and -1.0 < ratio < 0.5:
        Isotropic.model_validate(values)
    else:
        with pytest.raises(ValidationError, match="not positive definite"):
            Isotropic.model_validate(values)


@given(st.tuples(finite, finite, finite))
@settings(deadline=None)
def test_fibres_are_of_unit_length(fibre: tuple[float, float, float]) -> None:
    values = {
        "axial_youngs_modulus": "17 GPa",
        "transverse_youngs_modulus": "11.5 GPa",
        "axial_poisson_ratio": 0.31,
        "transverse_poisson_ratio": 0.51,
        "axial_shear_modulus": "3.3 GPa",
        "fibre": fibre,
    }
    if not any(fibre):
        with pytest.raises(ValidationError, match="zero vector"):
            TransverselyIsotropic.model_validate(values)
        return
    material = TransverselyIsotropic.model_validate(values)
    assert math.hypot(*material.fibre.axis) == pytest.approx(1.0, abs=1e-12)
    again = TransverselyIsotropic.model_validate(values | {"fibre": list(material.fibre.axis)})
    assert again.fibre == material.fibre


# ------------------------------------------------------------------------------- round trip


def quantity(unit: str, values: st.SearchStrategy[float] = moderate) -> st.SearchStrategy[str]:
    return values.map(lambda v: f"{v!r} {unit}")


def vector(unit: str) -> st.SearchStrategy[Any]:
    listed = st.lists(quantity(unit), min_size=3, max_size=3)
    joined = st.lists(moderate, min_size=3, max_size=3).map(
        lambda v: f"[{', '.join(map(repr, v))}] {unit}"
    )
    return listed | joined


@st.composite
def cases(draw: st.DrawFn) -> dict[str, Any]:
    """The data of a random valid case."""
    blocks = draw(st.lists(names, min_size=1, max_size=3, unique=True))
    side = st.floats(1.0, 100.0)
    x, y = draw(quantity("mm", side)), draw(quantity("cm", side))
    stages = draw(st.lists(names, min_size=1, max_size=3, unique=True))
    history = st.lists(finite, min_size=len(stages), max_size=len(stages)) | st.none()
    elastic = st.fixed_dictionaries(
        {"youngs_modulus": quantity("GPa", positive), "poisson_ratio": st.floats(-0.99, 0.49)},
        optional={
            "eigenstrains": st.lists(
                st.fixed_dictionaries({"strain": finite, "history": history}), max_size=2
            )
        },
    )
    expressions = st.sampled_from(["0.01 * x", "-min(x, y) / (1 + z)", "-x", "3*max(x, 1e-3*z)"])
    contact = st.fixed_dictionaries(
        {"kind": st.just("contact"), "friction_coefficient": st.floats(0.0, 5.0)},
        optional={
            "gap": quantity("um") | expressions,
            "gap_history": history,
            "augmentation": quantity("MPa/mm", positive),
        },
    )
    laws = contact | st.just({"kind": "bonded"})
    support = st.fixed_dictionaries(
        {"kind": st.just("displacement"), "boundary": st.just("x_min")},
        optional={"history": history},
    ).flatmap(lambda d: (quantity("mm") | expressions).map(lambda q: d | {"x": q}))
    force = st.fixed_dictionaries(
        {"kind": st.just("force"), "boundary": st.just("top"), "force": vector("kN")},
        optional={"at": vector("mm"), "history": history},
    )
    density = st.lists(quantity("MN/m^3") | expressions, min_size=3, max_size=3)
    volume = st.fixed_dictionaries(
        {
            "kind": st.just("body_force"),
            "density": density | density.map(lambda d: f"[{', '.join(d)}]"),
        }
    )
    scalars = st.integers() | finite | st.booleans() | st.text(max_size=8)
    return {
        "title": draw(st.text(max_size=20)),
        "geometry": {
            "kind": "blocks",
            "blocks": [{"name": n, "size": [x, y, draw(quantity("mm", side))]} for n in blocks],
        },
        # Blocks of 1 mm go with edges of up to 20 mm.
        "mesh": {
            "size": draw(quantity("mm", st.floats(1e-3, 20.0))),
            "order": draw(st.sampled_from([1, 2])),
        },
        "regions": {n: draw(elastic) for n in blocks},
        "interfaces": {f"{a}_{b}": draw(laws) for a, b in pairwise(blocks)},
        "supports": {"base": {"kind": "fixed", "boundary": "bottom"}, "side": draw(support)},
        "loads": {draw(names): draw(force | volume)},
        "stages": [{"name": n, "increments": draw(st.integers(1, 99))} for n in stages],
        "solver": {"petsc": draw(st.dictionaries(names, scalars, max_size=3))},
    }


kelvin = st.floats(1e-3, 1e4).map(lambda v: f"{v!r} K")
celsius = st.floats(-273.0, 1e4).map(lambda v: f"{v!r} degC")
temperatures = kelvin | celsius
parts = st.floats(0.0, 0.99)


def table(
    first: st.SearchStrategy[float], unit: str, second: st.SearchStrategy[Any]
) -> st.SearchStrategy[Any]:
    """Pairs whose first entries increase."""
    keys = st.lists(first, min_size=2, max_size=4, unique=True).map(sorted)
    return keys.flatmap(
        lambda ts: st.tuples(*(second for _ in ts)).map(
            lambda vs: [[f"{t!r} {unit}", v] for t, v in zip(ts, vs, strict=True)]
        )
    )


seconds = st.floats(0.0, 1e5)
courses = table(seconds, "s", moderate)


@st.composite
def thermal(draw: st.DrawFn, expands: bool) -> dict[str, Any]:
    """The data of a region that conducts, and maybe sets."""
    result: dict[str, Any] = {
        "density": draw(quantity("kg/m^3", positive)),
        "specific_heat": draw(quantity("J/(kg K)", positive)),
        "initial_temperature": draw(temperatures),
    }
    if draw(st.booleans()):
        result["conductivity"] = draw(quantity("W/(m K)", positive))
    else:
        for direction in ("axial", "transverse"):
            result[f"{direction}_conductivity"] = draw(quantity("W/(m K)", positive))
        if draw(st.booleans()):
            along = [1, draw(moderate), draw(moderate)]
            kind = draw(st.sampled_from(["", "circumferential", "radial"]))
            through = [draw(quantity("cm", moderate)) for _ in "xyz"]
            result["fibre"] = {"kind": kind, "axis": along, "through": through} if kind else along
    if draw(st.booleans()):
        result["cure"] = draw(cures())
    if expands and draw(st.booleans()):
        result["thermal_expansion"] = draw(quantity("1/K", st.floats(1e-9, 1e-2)))
        if "cure" not in result and draw(st.booleans()):
            result["reference_temperature"] = draw(temperatures)
    return result


def cures() -> st.SearchStrategy[dict[str, Any]]:
    """How a region sets."""
    numbers = st.floats(0.0, 3.0)
    reaction = st.fixed_dictionaries(
        {
            "kind": st.just("autocatalytic"),
            "rate_constant": quantity("1/min", positive),
            "activation_energy": quantity("kJ/mol", positive),
            "m": numbers,
            "n": numbers,
        },
        optional={"limit": table(st.floats(1.0, 1e3), "K", st.floats(0.99, 1.0))},
    )
    clock = st.fixed_dictionaries(
        {"kind": st.just("prescribed"), "rate": table(seconds, "s", positive)}
    )
    return st.fixed_dictionaries(
        {"kinetics": reaction | clock, "heat": quantity("MJ/m^3", positive)},
        optional={
            "initial": st.floats(1e-9, 0.99),
            "gel": parts,
            "floor": st.floats(1e-6, 1.0),
            "exponent": positive,
            "shrinkage": parts,
        },
    )


def conditions(regions: list[str]) -> st.SearchStrategy[dict[str, Any]]:
    """What brings heat in or takes it away."""
    place = st.just({"boundary": "top"}) | st.lists(
        st.sampled_from(regions), min_size=1, max_size=2, unique=True
    ).map(lambda names: {"regions": names})
    by = temperatures.map(lambda t: {"temperature": t}) | table(seconds, "s", temperatures).map(
        lambda c: {"course": c}
    )
    fixed = st.tuples(place, by).map(lambda d: {"kind": "temperature"} | d[0] | d[1])
    flux = st.fixed_dictionaries(
        {
            "kind": st.just("flux"),
            "boundary": st.just("x_min"),
            "flux": quantity("kW/m^2") | st.just("exp(-x) * y"),
        },
        optional={"course": courses},
    )
    film = st.fixed_dictionaries(
        {
            "kind": st.just("convection"),
            "boundary": st.just("bottom"),
            "coefficient": quantity("W/(m^2 K)", positive),
            "ambient": temperatures,
        }
    )
    source = st.fixed_dictionaries(
        {
            "kind": st.just("source"),
            "regions": st.just(regions),
            "density": quantity("kW/m^3") | st.just("exp(-z)"),
        },
        optional={"course": courses},
    )
    blood = st.fixed_dictionaries(
        {
            "kind": st.just("perfusion"),
            "regions": st.just(regions[:1]),
            "rate": quantity("1/hour", positive),
            "blood_density": quantity("g/cm^3", positive),
            "blood_specific_heat": quantity("kJ/(kg K)", positive),
            "temperature": temperatures,
        }
    )
    return fixed | flux | film | source | blood


constant = quantity("W/(m^2 K)", st.floats(0.0, 1e9))
by_pressure = st.fixed_dictionaries(
    {
        "kind": st.just("pressure"),
        "open": quantity("W/(m^2 K)", st.floats(0.0, 1e3)),
        "per_pressure": quantity("W/(m^2 K MPa)", positive),
    },
    optional={"cap": quantity("W/(m^2 K)", st.floats(1e3, 1e9))},
)


@st.composite
def hot_cases(draw: st.DrawFn) -> dict[str, Any]:
    """The data of a random valid case with heat: with or without mechanics."""
    data = draw(cases())
    solid = draw(st.booleans())
    for name, region in data["regions"].items():
        region["thermal"] = draw(thermal(expands=solid))
        if not solid:
            data["regions"][name] = {"kind": "conductor", "thermal": region["thermal"]}
    for name, law in data["interfaces"].items():
        if not solid:
            law = data["interfaces"][name] = {"kind": "bonded"}
        rubs = law.get("friction_coefficient", 0.0) > 0.0
        touches = law["kind"] != "bonded"
        laws = constant | st.just("perfect") | (by_pressure if touches else st.nothing())
        law |= draw(st.fixed_dictionaries({}, optional={"conductance": laws}))
        if rubs and draw(st.booleans()):
            law["friction_heating"] = draw(st.just("effusivity") | st.floats(0.0, 1.0))
    for stage in data["stages"]:
        stage["duration"] = draw(quantity("min", positive))
    if solid:
        held = st.lists(st.sampled_from([s["name"] for s in data["stages"]]), min_size=1)
        data["supports"]["side"]["stages"] = draw(held)
    else:
        del data["supports"], data["loads"]
    regions = list(data["regions"])
    data["heat"] = draw(st.dictionaries(names, conditions(regions), max_size=3))
    data["time"] = draw(
        st.fixed_dictionaries(
            {},
            optional={
                "method": st.sampled_from(["sdirk4", "backward_euler"]),
                "tolerance": quantity("mK", positive),
                "first_step": quantity("ms", positive),
                "mechanical_step": quantity("K", positive),
            },
        )
    )
    probe = st.fixed_dictionaries(
        {"at": vector("mm")}, optional={"region": st.sampled_from(regions)}
    )
    data["output"] = {"probes": draw(st.dictionaries(names, probe | vector("mm"), max_size=2))}
    return data


@given(cases() | hot_cases())
def test_dump_and_load_give_an_equal_case(tmp_path_factory: Any, data: dict[str, Any]) -> None:
    try:
        case = resolve(yaml_file.CaseFile("case.yaml", data), Path())
    except InputError as error:
        # Random block names can make two interfaces of the same name.
        assert "same name" in str(error)
        return
    path = tmp_path_factory.mktemp("case") / "case.yaml"
    path.write_text(dump(case), encoding="utf-8", newline="")
    assert load(path).config == case


@given(temperatures)
@settings(deadline=None)
def test_temperatures_survive_writing(text: str) -> None:
    adapter: TypeAdapter[float] = TypeAdapter(Temperature)
    try:
        value = adapter.validate_python(text)
    except ValidationError:
        assert float(text.split()[0]) + 273.15 * text.endswith("degC") <= 1e-12
        return
    assert adapter.validate_python(adapter.dump_python(value, mode="json")) == value


@given(st.text(max_size=200) | st.binary(max_size=200))
def test_any_file_is_a_case_or_a_told_error(tmp_path_factory: Any, content: str | bytes) -> None:
    path = tmp_path_factory.mktemp("case") / "case.yaml"
    raw = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    path.write_bytes(raw)
    with pytest.raises(InputError) as caught:
        load(path)
    assert all(line.startswith(str(path)) for line in caught.value.messages)


@given(st.text(max_size=40))
def test_any_override_is_applied_or_told(text: str) -> None:
    path = Path(__file__).parents[2] / "configs" / "blocks.yaml"
    try:
        load(path, [text])
    except InputError as error:
        assert all(line.startswith("--set ") for line in error.messages)
