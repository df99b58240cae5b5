"""What is said of a limit, from what was found of it."""

from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.evidence.words.limit_kinds import words_of
from bo_tuner.evidence.words.reasons import condition
from bo_tuner.study.limits import Standing
from bo_tuner.text import counted


def asked(found: LimitVerdict) -> str:
    """Return how often the limit must be kept, such as ``in 90 % of the runs``."""
    return words_of(found.constraint).asked(everywhere=found.everywhere)


def counted_runs(found: LimitVerdict) -> str:
    """Return how many test runs are beyond the limit, and how many may be."""
    if not found.runs:
        return "no test run is complete"
    said = words_of(found.constraint).counted(
        found.violations,
        counted(found.runs, "test run"),
        found.runs,
        agrees=found.unsearched or not found.refuted,
    )
    if found.unsearched:
        return f"{said} (no search was made for its worst context)"
    chance = found.standing is Standing.OPEN and found.exceeds and not found.certified
    return f"{said}, which may be chance" if chance else said


def in_words(found: LimitVerdict) -> str:
    """Return what was found, in words that follow those of the limit."""
    passed = found.standing is Standing.SHOWN
    if found.certified:
        if passed and found.condition is not None:
            return f"shown to stay within it {asked(found)}, if {condition(found.condition)}"
        return f"{'' if passed else 'NOT '}proven to be kept {asked(found)}"
    evidence = counted_runs(found)
    if passed:
        confidence = f"{100.0 * found.confidence:g} % confidence"
        return f"proven to be kept {asked(found)}: {evidence} ({confidence})"
    if found.refuted:
        return f"NOT kept: {evidence}"
    if found.unsearched or not found.runs:
        return f"NOT proven to be kept: {evidence}"
    return evidence


def limit_with_unit(found: LimitVerdict) -> str:
    """Return the limit with its unit."""
    return f"{found.constraint.limit:g} {found.unit}".rstrip()


def as_mapping(found: LimitVerdict) -> dict[str, object]:
    """Return it as it stands in files."""
    return {
        "standing": str(found.standing),
        "runs": found.runs,
        "violations": found.violations,
        "permitted": found.permitted,
        "asked": asked(found),
        "evidence": "" if found.certified else counted_runs(found),
        "words": in_words(found),
        "refuted": found.refuted,
        "condition": "" if found.condition is None else condition(found.condition),
    }
