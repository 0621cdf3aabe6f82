"""Influence of bone that was not measured on the numbers of a run.

A shaft is continued below the end of a scan, and a canal that no file has follows the bone.
Companions of the run on a coarser mesh differ in them: in the level at which the shaft is held, and
in the width of its canal. The differences of their numbers show how much they depend on this bone.
"""

from __future__ import annotations

import logging

from app.case.case import Case
from app.case.quantities import Quantity
from app.case.summary import BoneInfluence, Summary
from app.case.summary_numbers import main_numbers
from app.foundation.layout import percent
from app.results.error_estimate import largest_of_units, reference_size
from app.simulation.model import Model

log = logging.getLogger("mantle")

# Mesh size of the companions over that of the run.
COARSENING_OF_COMPANIONS = 2.0


def bone_influence(case: Case, model: Model) -> BoneInfluence | None:
    """Return the changes of main numbers by other bone where none was measured; collective.

    The result is None if all bone was measured, a companion is not solved, or the run has no main
    numbers.
    """
    geometry = case.geometry
    other_bones = geometry.other_bones
    if not other_bones or not model.mechanics:
        return None
    coarsest = geometry.coarsest_size
    mesh = case.mesh.coarser(
        min(COARSENING_OF_COMPANIONS, coarsest / case.mesh.size) if case.mesh.size else 1.0
    )
    companions = [
        case.model_copy(update={"mesh": mesh, "geometry": g})
        for g in (geometry, *other_bones.values())
    ]
    solved = list[Summary]()
    for companion in companions:
        numbers, reason = model.numbers_or_reason(companion)
        if numbers is None:
            log.warning("assumed bone: its influence is unknown: %s", reason)
            return None
        solved.append(numbers)
    numbers_as_run, *numbers_of_others = solved
    changes = dict[str, dict[str, list[float]]]()
    changes_in_words = list[str]()
    for difference, numbers in zip(other_bones, numbers_of_others, strict=True):
        changes[difference], largest_text = _changes(numbers_as_run, numbers)
        if not changes[difference]:
            return None
        changes_in_words.append(f"by at most {largest_text} with {difference}")
    sentence = (
        f"main numbers change {', and '.join(changes_in_words)}, on cells of {mesh.size:g} mm"
    )
    return BoneInfluence(mesh_size=mesh.size, changes=changes, sentence=sentence)


def _changes(first: Summary, second: Summary) -> tuple[dict[str, list[float]], str]:
    """Return main numbers of both companions by name, and the largest change in words."""
    largest = largest_of_units(first)
    values_of_second = {name: value for name, _, value, _ in main_numbers(second)}
    numbers_of_both = dict[str, list[float]]()
    relative = dict[str, float]()
    quantities = dict[str, Quantity]()
    for name, q, first_value, _ in main_numbers(first):
        second_value = values_of_second.get(name)
        if q.order and first_value is not None and second_value is not None:
            numbers_of_both[name] = [first_value, second_value]
            size = reference_size(first_value, q, largest)
            relative[name] = abs(second_value - first_value) / size if size else 0.0
            quantities[name] = q
    if not numbers_of_both:
        return numbers_of_both, ""
    most_changed = max(relative, key=lambda full_name: relative[full_name])
    change, q = percent(relative[most_changed]), quantities[most_changed]
    first_text, second_text = (q.text({q.key: value}) for value in numbers_of_both[most_changed])
    return numbers_of_both, f"{change} ({most_changed}: {first_text} and {second_text} {q.shown})"
