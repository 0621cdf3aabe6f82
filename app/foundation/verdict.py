"""A verdict: one finding on a case, its mesh, its solution or its numbers.

Whoever finds something says it once, as a `Verdict`. Errors carry verdicts, a run collects those on
its numbers in ``verdicts`` of ``summary.json``, and terminal, page, comparison and evidence print
that list.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any


class Reason(StrEnum):
    """Reason of a failure, for programs: in brackets in the message."""

    FLOATING_BODY = "loose-body"
    """Nothing holds a body, or friction hardly does."""
    LARGE_DISPLACEMENT = "large-displacement"
    """Displacements are no longer small, though everything is held."""
    NOT_UNIQUE = "not-unique"
    """Friction is so high that the solution is not unique."""
    RIGID_CONTACT = "rigid-contact"
    """Neither side of an interface is elastic."""
    MISSING_PART = "missing-part"
    """The mesh lacks a region, a boundary or an interface."""

    @classmethod
    def within(cls, text: str) -> set[Reason]:
        """Reasons in a message."""
        return {reason for reason in cls if f"[{reason}]" in text}


class Severity(StrEnum):
    """Severity of a verdict."""

    ERROR = "error"
    """The case is refused, the solution failed, or its numbers must not be used."""
    WARNING = "warning"
    """A number is doubtful."""
    NOTE = "note"
    """The input is allowed, but rarely meant."""
    PLAIN = "plain"
    """A fact that is neither good nor bad."""
    GOOD = "good"
    """A check is passed."""


# Tone in which the terminal prints each severity.
TONES = {
    Severity.ERROR: "bad",
    Severity.WARNING: "doubtful",
    Severity.NOTE: "doubtful",
    Severity.PLAIN: "",
    Severity.GOOD: "good",
}


@dataclass(frozen=True)
class Verdict:
    """A finding.

    Attributes:
        what: The finding, with its numbers and units.
        where: Place: a key of the file, a stage, or the part of the result that it judges.
        remedy: What to do.
        severity: Severity, from an error to a passed check.
        code: Reason, for programs.
    """

    what: str
    where: str = ""
    remedy: str = ""
    severity: Severity = Severity.ERROR
    code: Reason | None = None

    @property
    def text(self) -> str:
        """Place, finding, remedy and reason in one line."""
        text = f"{self.where}: {self.what}" if self.where else self.what
        if self.remedy:
            text += f"; {self.remedy}"
        return f"{text} [{self.code}]" if self.code else text

    def __str__(self) -> str:
        """The text, marked if it is a note."""
        return f"note: {self.text}" if self.severity is Severity.NOTE else self.text

    @property
    def tone(self) -> str:
        """Tone in which the terminal prints it."""
        return TONES[self.severity]

    def record(self) -> dict[str, str]:
        """Return the entry in ``summary.json``."""
        return {key: str(value) for key, value in asdict(self).items() if value}


def note(what: str, where: str = "", remedy: str = "") -> Verdict:
    """Return a note on input that is allowed, but rarely meant."""
    return Verdict(what, where, remedy, Severity.NOTE)


def recorded(summary: Mapping[str, Any]) -> list[Verdict]:
    """Return the verdicts of ``summary.json``."""
    verdicts = []
    for entry in summary.get("verdicts", []):
        severity = Severity(entry["severity"])
        code = Reason(entry["code"]) if "code" in entry else None
        # Earlier results have `cure`.
        remedy = entry.get("remedy", entry.get("cure", ""))
        verdict = Verdict(entry["what"], entry.get("where", ""), remedy, severity, code)
        verdicts.append(verdict)
    return verdicts


def texts_of(verdicts: Sequence[Verdict], severity: Severity) -> list[str]:
    """Return the texts of the verdicts of a severity."""
    return [v.text for v in verdicts if v.severity is severity]


def story(verdicts: Sequence[Verdict]) -> str:
    """Return verdicts on a failure in lines: the failure, its circumstances, then its remedy."""
    first, *others = verdicts
    code = f" [{first.code}]" if first.code else ""
    lines = [f"{first.where}: {first.what}{code}" if first.where else f"{first.what}{code}"]
    lines += [v.text for v in others]
    if first.remedy:
        lines.append(f"what to do: {first.remedy}")
    return "\n  ".join(lines)
