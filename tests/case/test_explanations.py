"""Texts of ``mantle explain`` for words that engineers type, for keys and for units."""

from __future__ import annotations

from functools import cache

import pytest

from app.case import explanations, keys, library, quantities
from app.command_line.parser import options_of_commands
from app.foundation.errors import InputError

READ_ONCE = cache(library.read)
# Words, and how the first line of the answer begins.
WORDS = {
    "E": "regions.<name>.youngs_modulus ",
    "nu": "regions.<name>.poisson_ratio ",
    "mu": "interfaces.<name>.friction_coefficient ",
    "encastre": "supports.<name> of kind fixed",
    "fixed": "supports.<name> of kind fixed",
    "sliding": "interfaces.<name>.sliding ",
    "body weight": "loads",
    "mesh size": "mesh.size",
    "units": "Results, in summary.json",
    "density": "regions.<name>.thermal.density",
    "friction": "interfaces.<name>.friction_coefficient ",
    "roller": "supports.<name> of kind roller",
    "contact": "interfaces.<name> of kind contact",
    "debonding": "interfaces.<name> of kind cohesive",
    "cohesive": "interfaces.<name> of kind cohesive",
    "pressure": "loads.<name> of kind pressure",
    "temperature": "heat.<name> of kind temperature",
    "conductance": "interfaces.<name>.conductance ",
    "thermal expansion": "regions.<name>.thermal.thermal_expansion",
    "symmetry": "supports.<name> of kind roller",
    "micromotion": "interfaces.motion_p99 ",
    "von mises": "regions.von_mises_max ",
    "subsidence": "stem.subsidence ",
    "load history": "loads.<name>.history ",
    "time step": "time.first_step",
    "tolerance": "solver.tolerance",
    "restart": "output.checkpoint",
    "output": "output",
    "probe": "output.probes",
    "gruen": "gruen.strain_energy_density ",
    "contact law": "interfaces.<name> of kind contact",
    "mortar": "interfaces.<name>.quadrature ",
    "figure": "output.report",
    "broach": "geometry.canal.ream",
    "finite": "interfaces.<name>.sliding ",
    "multigrid": "solver.linear",
    "quarter": "geometry.sector ",
}
# Further lines of some answers.
FURTHER = {
    "sliding": ["interfaces.slip_p99", "finite sliding"],
    "body weight": ["body_weight: 750 N scales", "walking"],
    "friction": ["interfaces.<name>.friction_heating", "friction coefficient: "],
    "debonding": ["interfaces.gap_p99"],
    "pressure": ["interfaces.pressure_p95"],
    "temperature": ["thermal.regions.temperature_max"],
    "micromotion": ["interfaces.micromotion_p99", "micromotion: motion of a press fit"],
    "restart": ["mantle run --restart"],
    "tolerance": ["time.tolerance"],
    "gruen": ["Gruen zone: "],
    "contact law": ["of kind cohesive", "contact law: relation of gap and contact traction"],
    "broach": ["value none, by, broach"],
    "multigrid": ["multigrid: preconditioner"],
    "mortar": ["mortar: integral coupling"],
    "figure": ["figure: picture of a run", "docs/paper.md"],
}


@pytest.fixture(autouse=True)
def library_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read the library once for all explanations."""
    monkeypatch.setattr(library, "read", READ_ONCE)


@pytest.mark.parametrize("word", WORDS)
def test_explanations_of_a_word_begins_with_its_key_or_number(word: str) -> None:
    text = explanations.explained(word, options_of_commands())
    first = " ".join(text.splitlines()[0].split()) + " "
    assert first.startswith(WORDS[word])
    assert all(part in " ".join(text.split()) for part in FURTHER.get(word, ()))
    assert max(map(len, text.splitlines())) <= 100


@pytest.mark.parametrize("word", explanations.TARGETS_OF_TERMS)
def test_explanations_of_every_listed_word_finds_all_its_targets(word: str) -> None:
    options = options_of_commands()
    text = explanations.explained(word, options)
    for target in explanations.TARGETS_OF_TERMS[word]:
        kind = target.partition(": ")[2]
        first = f"of kind {kind}" if kind else explanations.explained(target, options)
        assert first.splitlines()[0] in text


def test_explanations_of_a_word_of_a_meaning_lists_the_keys() -> None:
    assert explanations.explained("Pennes").split()[:2] == ["heat.<name>:", "perfusion"]
    with pytest.raises(InputError, match="is not a key, kind, result or term of mantle; nearest: "):
        explanations.explained("xyzzy")


def test_explanations_of_a_phrase_has_all_its_words() -> None:
    """The glossary has no term `law of contact`, but one with both words."""
    text = explanations.explained("law of contact")
    assert text.startswith("  contact law: ")
    assert "regions.<name>.youngs_modulus.law" not in text


def test_explanations_of_a_phrase_falls_back_to_one_of_its_words() -> None:
    for phrase in ("xyzzy subsidence", "subsidence xyzzy"):
        assert explanations.explained(phrase) == explanations.explained("subsidence")
    with pytest.raises(InputError, match="xyzzy yzzyx: is not a key, kind, result or term"):
        explanations.explained("xyzzy yzzyx")


def test_explanations_of_the_end_of_a_path_is_that_of_the_path() -> None:
    for end in ("canal.isthmus", "isthmus"):
        assert explanations.explained(end) == explanations.explained("geometry.canal.isthmus")


def test_explanations_of_every_key_has_value_or_kinds() -> None:
    for section in keys.key_sections():
        for key in section.keys:
            text = explanations.explained(key.path)
            expected = "{kind: " if key.name == "kind" else "  value "
            assert "`" not in text and expected in text and "](#" not in text
            assert max(map(len, text.splitlines())) <= 100


def test_explanations_of_units_lists_their_keys() -> None:
    lines = explanations.explained("units").splitlines()
    assert any(line.split()[:2] == ["MPa", "youngs_modulus,"] for line in lines)
    assert explanations.explained("unit") == explanations.explained("units")


def test_explanations_of_units_has_those_of_results_and_of_keys() -> None:
    results, key_units = explanations.explained("units").split("\n\n")
    units_of_results = {line[2:16].strip() for line in results.splitlines()[1:]}
    units_of_tables = set()
    for numbers in quantities.TABLE.values():
        units_of_tables |= {quantity.unit for quantity in numbers.values()}
    assert units_of_results == units_of_tables
    # Results on interfaces are in W/m^2; the key of their conductance is converted to mW/mm^2.
    assert any(line.split()[:2] == ["W/m^2", "heat_flux_max"] for line in results.splitlines())
    assert any("conductance" in line and "mW" in line for line in key_units.splitlines())


def test_explanations_of_a_command_has_its_options_in_their_block() -> None:
    options = options_of_commands()
    section, *others, last = explanations.explained("mesh", options).split("\n\n")
    assert section.startswith("mesh\n")
    assert not any("mantle mesh --" in text for text in [section, *others])
    heading, *lines = last.splitlines()
    assert heading == "options of commands"
    assert any(line.startswith("  mantle mesh --set ") for line in lines)
    (restart,) = explanations.explained("--restart", options).split("\n\n")
    assert restart.startswith("options of commands\n  mantle run --restart ")
