"""Credibility of a computational model: context of use, risk, factors with their gradations.

The 13 factors of ASME V&V 40-2018 with their sub-factors make 23. Two more are evidence that the
guidance of the FDA of November 2023 asks for and the standard does not number: calibration, and
uncertainty of the result. The standard is not public. Its sub-factors are in Table 5 of
Galappaththige et al. 2022 (PLoS Comput Biol 18:e1010541), and its gradations in public assessments
that follow it; the scales here are shortened. The scales of the last two factors are mantle's.
"""

from __future__ import annotations

from math import ceil
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from app.schema.section import ITEMS, MAPPING, Section, Text

# Letters of the grades, from the least rigorous on.
GRADES = "abcd"
Grade = Literal["a", "b", "c", "d"]
Level = Literal["low", "medium", "high"]
LEVELS: tuple[Level, ...] = ("low", "medium", "high")
# Risk is 1 to 5: one more for each step of influence or consequence above the lowest.
RISKS = ("low", "low to medium", "medium", "medium to high", "high")


class CredibilityFactor(NamedTuple):
    """A credibility factor.

    Attributes:
        group: Activity to which it belongs.
        name: Name in words.
        scale: Meaning of its grades a, b, c, d, from the least rigorous on.
    """

    group: str
    name: str
    scale: tuple[str, ...]

    def goal(self, risk: int) -> Grade:
        """Grade that is proposed for a risk from 1 to 5: the same part of the scale."""
        index = ceil(risk * len(self.scale) / len(RISKS)) - 1
        return _grade(index)

    def next_grade(self, grade: Grade | None) -> Grade | None:
        """Grade above one, or above no evidence; None above the highest."""
        index = 0 if grade is None else GRADES.index(grade) + 1
        return _grade(index) if index < len(self.scale) else None

    def meaning(self, grade: Grade) -> str:
        """Meaning of a grade."""
        return self.scale[GRADES.index(grade)]


def _grade(index: int) -> Grade:
    grades: tuple[Grade, ...] = ("a", "b", "c", "d")
    return grades[index]


CODE = "verification: code"
CALCULATION = "verification: calculation"
MODEL = "validation: computational model"
SAMPLES = "validation: test samples"
CONDITIONS = "validation: test conditions"
ASSESSMENT = "validation: assessment"
APPLICABILITY = "applicability"
GUIDANCE = "guidance of 2023"

# The same scale of measurement uncertainty is used for samples and conditions.
_MEASUREMENT_UNCERTAINTY = (
    "not measured, or measured without a statement of uncertainty",
    "accuracy of the instruments",
    "accuracy of the instruments and repeatability",
    "accuracy, repeatability and all other influences on the measurement",
)

FactorName = Literal[
    "software_quality_assurance",
    "numerical_code_verification",
    "discretization_error",
    "numerical_solver_error",
    "use_error",
    "model_form",
    "input_sensitivities",
    "input_uncertainties",
    "sample_quantity",
    "sample_range",
    "sample_measurements",
    "sample_uncertainty",
    "condition_quantity",
    "condition_range",
    "condition_measurements",
    "condition_uncertainty",
    "input_equivalency",
    "output_quantity",
    "output_equivalency",
    "output_rigor",
    "output_agreement",
    "relevant_quantities",
    "relevant_validation",
    "calibration",
    "result_uncertainty",
]

CREDIBILITY_FACTORS: dict[FactorName, CredibilityFactor] = {
    "software_quality_assurance": CredibilityFactor(
        CODE,
        "software quality assurance",
        (
            "few or no procedures",
            "procedures are documented and followed",
            "known anomalies and the environment are assessed for this use; quality is measured",
        ),
    ),
    "numerical_code_verification": CredibilityFactor(
        CODE,
        "numerical code verification",
        (
            "none",
            "compared with the solution of another verified code",
            "errors against exact solutions decrease on finer meshes",
            "observed orders of convergence are compared with the theoretical ones",
        ),
    ),
    "discretization_error": CredibilityFactor(
        CALCULATION,
        "discretization error",
        (
            "convergence was not examined",
            "results converge with mesh and step; the error is not estimated",
            "the error of mesh and step is estimated",
        ),
    ),
    "numerical_solver_error": CredibilityFactor(
        CALCULATION,
        "numerical solver error",
        (
            "solver parameters were not examined",
            "solver parameters are those of a verified model",
            "for this problem, changes of solver parameters have a negligible effect",
        ),
    ),
    "use_error": CredibilityFactor(
        CALCULATION,
        "use error",
        (
            "inputs and outputs were not verified by a person",
            "verified by the practitioner",
            "verified by internal review",
            "reproduced in an external review",
        ),
    ),
    "model_form": CredibilityFactor(
        MODEL,
        "model form",
        (
            "the influence of assumptions was not explored",
            "the influence of key assumptions was explored",
            "all assumptions were evaluated",
        ),
    ),
    "input_sensitivities": CredibilityFactor(
        MODEL,
        "model inputs: sensitivities",
        (
            "no sensitivity analysis",
            "sensitivity to the expected key inputs",
            "sensitivity to all inputs",
        ),
    ),
    "input_uncertainties": CredibilityFactor(
        MODEL,
        "model inputs: uncertainties",
        (
            "not identified",
            "uncertainties of key inputs are quantified",
            "uncertainties of all inputs are quantified and propagated to the results",
        ),
    ),
    "sample_quantity": CredibilityFactor(
        SAMPLES,
        "quantity of test samples",
        ("one sample", "several, too few for statistics", "enough for statistics"),
    ),
    "sample_range": CredibilityFactor(
        SAMPLES,
        "range of characteristics of test samples",
        ("one set of characteristics", "a range near nominal", "the expected extremes"),
    ),
    "sample_measurements": CredibilityFactor(
        SAMPLES,
        "measurements of test samples",
        ("not measured", "one or more key characteristics", "all key characteristics"),
    ),
    "sample_uncertainty": CredibilityFactor(
        SAMPLES, "uncertainty of measurements of test samples", _MEASUREMENT_UNCERTAINTY
    ),
    "condition_quantity": CredibilityFactor(
        CONDITIONS,
        "quantity of test conditions",
        ("one condition", "two to four conditions", "more than four conditions"),
    ),
    "condition_range": CredibilityFactor(
        CONDITIONS,
        "range of test conditions",
        (
            "one condition",
            "a range near nominal",
            "the expected extremes",
            "the whole range of conditions",
        ),
    ),
    "condition_measurements": CredibilityFactor(
        CONDITIONS,
        "measurements of test conditions",
        ("described in words", "one or more key characteristics", "all key characteristics"),
    ),
    "condition_uncertainty": CredibilityFactor(
        CONDITIONS, "uncertainty of measurements of test conditions", _MEASUREMENT_UNCERTAINTY
    ),
    "input_equivalency": CredibilityFactor(
        ASSESSMENT,
        "equivalency of input parameters",
        (
            "some inputs of model and test are of different types",
            "the same types of inputs, but not the same ranges",
            "the same types and ranges of inputs",
        ),
    ),
    "output_quantity": CredibilityFactor(
        ASSESSMENT,
        "quantity of compared outputs",
        ("one output", "several outputs"),
    ),
    "output_equivalency": CredibilityFactor(
        ASSESSMENT,
        "equivalency of output parameters",
        ("outputs of different types", "similar types", "equivalent types"),
    ),
    "output_rigor": CredibilityFactor(
        ASSESSMENT,
        "rigor of output comparison",
        (
            "visual comparison",
            "difference of model and test",
            "difference with the uncertainty of model or test",
            "difference with the uncertainties of model and test",
        ),
    ),
    "output_agreement": CredibilityFactor(
        ASSESSMENT,
        "agreement of output comparison",
        (
            "not satisfactory for key outputs",
            "satisfactory for key outputs, not for all",
            "satisfactory for all outputs",
        ),
    ),
    "relevant_quantities": CredibilityFactor(
        APPLICABILITY,
        "relevance of the quantities of interest",
        (
            "validated quantities are unrelated to those of the context of use",
            "related, but not identical",
            "some of the quantities of the context of use were validated",
            "all quantities of the context of use were validated",
        ),
    ),
    "relevant_validation": CredibilityFactor(
        APPLICABILITY,
        "relevance of the validation to the context of use",
        (
            "the validation does not overlap the context of use",
            "the validation overlaps a part of the context of use",
            "the validation covers the context of use",
        ),
    ),
    "calibration": CredibilityFactor(
        GUIDANCE,
        "calibration",
        (
            "inputs were fitted to the data of the validation, or this is unknown",
            "the origin of some inputs is unknown, or the quality of a fit is not reported",
            "nothing was fitted, or the quality of the fit to other data is reported",
        ),
    ),
    "result_uncertainty": CredibilityFactor(
        GUIDANCE,
        "uncertainty of the results in the context of use",
        (
            "not quantified",
            "discretization error or effect of uncertain inputs",
            "both",
            "both, and the difference from experiments, compared with the limit of the decision",
        ),
    ),
}


class Claim(Section):
    """Evidence that a person gives for a factor. Its grade replaces that of the program."""

    grade: Grade | Literal["none"] | None = None
    """Grade on the scale of the factor, or `none` if the evidence belongs to another subject;
    without it the program's grade stays."""
    text: Text
    """The evidence."""
    missing: Text = ""
    """Evidence that is missing for the next grade."""
    links: Annotated[tuple[Text, ...], ITEMS] = ()
    """Files of the evidence: of the program's repository, or your own."""


class Credibility(Section):
    """Question, context of use and risk of a case, for `mantle report --evidence`."""

    library: Text | None = None
    """Context of use of the library (`mantle explain contexts`); other keys change it."""
    question: Text = ""
    """The question of interest: the decision or statement to which the run contributes."""
    context_of_use: Text = ""
    """Role of the model in the answer: which results are used, for what, next to which other
    evidence."""
    influence: Level | None = None
    """Influence of the model on the decision, relative to other evidence."""
    influence_reason: Text = ""
    """Reason for the influence."""
    consequence: Level | None = None
    """Consequence of a wrong decision."""
    consequence_reason: Text = ""
    """Reason for the consequence."""
    evidence: Annotated[dict[FactorName, Claim], MAPPING] = Field(default_factory=dict)
    """Evidence that the program cannot know, by credibility factor."""
    status: Literal["assumed", "measured", "unverified"] | None = None
    """Origin of a context of the library."""
    source: Text | None = None
    """Where a context of the library is from."""

    @property
    def risk(self) -> int | None:
        """Risk from 1 to 5; None if influence or consequence is not stated."""
        if self.influence is None or self.consequence is None:
            return None
        return LEVELS.index(self.influence) + LEVELS.index(self.consequence) + 1
