"""What is said of a trial: in the terminal, on the live page and in the report."""

from bo_tuner.evidence.trial_row import TrialLimit, TrialOutcome, TrialRow
from bo_tuner.text import shown, shown_beside

SIGNS = {TrialOutcome.WITHIN: "✓", TrialOutcome.UNCERTAIN: "~", TrialOutcome.VIOLATES: "!"}
FAILED = "✗"


def sign(outcome: TrialOutcome) -> str:
    """Return the sign of an outcome."""
    return SIGNS.get(outcome, FAILED)


def outcome(row: TrialRow) -> str:
    """Return the outcome, with the values that are over a limit or too close to one."""
    kinds = (TrialOutcome.VIOLATES, TrialOutcome.UNCERTAIN)
    named = {kind: [_beside(each) for each in row.limits if each.outcome is kind] for kind in kinds}
    said = [f"{kind} ({', '.join(limits)})" for kind, limits in named.items() if limits]
    return "; ".join(said) or str(row.outcome)


def ending(row: TrialRow) -> str:
    """Return how a trial ended that is not complete, with what it takes to repeat that."""
    context = ", ".join(
        f"{name} {value:.3f}" if isinstance(value, float) else f"{name} {shown(value)}"
        for name, value in row.context.items()
    )
    how = "" if row.outcome is TrialOutcome.CUT_SHORT else f"{row.outcome.upper()}: "
    return f"{how}{row.reason} (context {context or 'none'}; seed {row.seed})"


def _beside(limit: TrialLimit) -> str:
    constraint = limit.constraint
    value = shown_beside(limit.value, constraint.limit)
    beyond = ">" if constraint.sign > 0.0 else "<"
    return f"{limit.title} {value} {beyond} {constraint.limit:g}"
