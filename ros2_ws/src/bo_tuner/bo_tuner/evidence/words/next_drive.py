"""What is said of drives that the search has not used."""

import math

from bo_tuner.evidence.next_drive import NextDrive
from bo_tuner.evidence.verdict import FAIL, PASS
from bo_tuner.text import counted


def headline(made: NextDrive) -> str:
    """Return the verdict in a line."""
    verdict = PASS if made.passed else FAIL
    return (
        f"{verdict}: at least {percent(made.shown)} of drives are within all limits, with "
        f"{percent(made.confidence)} confidence; asked for are {percent(made.asked)}"
    )


def sentences(made: NextDrive) -> list[str]:
    """Return what follows of drives to come, the verdict last."""
    count = len(made.runs)
    said = [
        f"within all limits: {made.within} of {counted(count, 'drive')}",
        f"the next drive is no worse than the worst of these with a probability of "
        f"{percent(made.no_worse_on_average)} on average ({count} of {count + 1}); with "
        f"{percent(made.confidence)} confidence, {percent(made.no_worse)} of all drives are not",
        "both hold if drives to come are like these: recorded by the same robot, in the same kind "
        "of places, none chosen for how it went",
        headline(made),
    ]
    if not made.passed:
        said.append(
            f"{counted(made.missing, 'more drive')} within all limits would show it, in a call "
            "with these"
        )
    return said


def percent(share: float) -> str:
    """Return a share in percent; it is rounded down, since no more is shown."""
    return f"{math.floor(1000.0 * share) / 10.0:g} %"
