"""What an examination finds: a verdict, figures, and findings that name causes and the options that mend them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from app.errors import InvalidScanError

Verdict = Literal["confirmed", "doubtful", "refused", "unknown"]
Severity = Literal["wrong", "doubtful"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that is wrong, or may be: a `code`, a sentence, and the build options that mend it.

    `certain` says that with these options the scan agrees as a right one does, and that no others do as well.
    """

    code: str
    sentence: str
    severity: Severity = "wrong"
    options: Mapping[str, Any] = field(default_factory=dict)
    certain: bool = False
    figures: Mapping[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return the finding for a report."""
        return {
            "code": self.code,
            "sentence": self.sentence,
            "severity": self.severity,
            "options": dict(self.options),
            "certain": self.certain,
            "figures": dict(self.figures),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Examination:
    """The verdict on a scan, its figures and its findings, those that stop a build first.

    `unknown` is a scan whose pictures share too little to examine it.
    """

    verdict: Verdict
    figures: Mapping[str, float | int | None]
    findings: tuple[Finding, ...]

    @property
    def wrong(self) -> tuple[Finding, ...]:
        """The findings that stop a build."""
        return tuple(finding for finding in self.findings if finding.severity == "wrong")

    @property
    def remedy(self) -> dict[str, Any] | None:
        """The options that mend all that is wrong, or None where one of them is not beyond doubt."""
        if not self.wrong or not all(finding.certain and finding.options for finding in self.wrong):
            return None
        return {name: value for finding in self.wrong for name, value in finding.options.items()}

    @property
    def warnings(self) -> tuple[str, ...]:
        """The sentences of what is doubtful."""
        return tuple(finding.sentence for finding in self.findings if finding.severity == "doubtful")

    def as_dict(self) -> dict[str, Any]:
        """Return the examination for a report."""
        return {
            "verdict": self.verdict,
            **self.figures,
            "findings": [finding.as_dict() for finding in self.findings],
        }


class RefusedScanError(InvalidScanError):
    """A scan that its examination refuses, with what was found and the options that would mend it."""

    def __init__(self, examination: Examination) -> None:
        sentences = " ".join(finding.sentence for finding in examination.wrong)
        if examination.remedy is not None:
            sentences += ' Or give "repair": true, which does this.'
        super().__init__(f"The scan contradicts itself, so no map is built from it. {sentences}")
        self.examination = examination
