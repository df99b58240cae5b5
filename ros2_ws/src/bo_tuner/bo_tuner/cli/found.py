"""Says what `check` has found, a line each."""

from bo_tuner.cli.streams import say_error
from bo_tuner.evidence.words.check import in_words
from bo_tuner.monitoring.display import say


def note(*facts: object) -> None:
    """Say what asks for a look."""
    for fact in facts:
        say(f"note: {in_words(fact)}")


def warn(*facts: object) -> None:
    """Say what may go wrong."""
    for fact in facts:
        say_error(f"warning: {in_words(fact)}")


def fault(*facts: object) -> None:
    """Say what is wrong."""
    for fact in facts:
        say_error(f"error: {in_words(fact)}")
