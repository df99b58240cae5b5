"""Names of the tasks of a campaign, by which the records are found again."""

from bo_tuner.trials import Value

CALIBRATION = "calibration"


def run_task(case: str, row: str, seed: int) -> str:
    """Name the run of a row with a seed."""
    return f"run/{case}/{row}/{seed}"


def point_task(case: str, point: str) -> str:
    """Name the verdict on a parameter set of the experiment."""
    return f"point/{case}/{point}"


def surrogates_task(case: str) -> str:
    """Name the final surrogates of a run, for their figure."""
    return f"surrogates/{case}"


def truth_task(case: str, first: Value) -> str:
    """Name the truth on the line of that figure where the first parameter has one value."""
    return f"truth/{case}/{first}"


def cost_task(dimension: int, seed: int) -> str:
    """Name the cost of a run with so many tuned parameters."""
    return f"cost/{dimension}/{seed}"
