"""Whether what runs the evaluations of a study can end a run before its time."""

from dataclasses import dataclass

from bo_tuner.errors import StudyError
from bo_tuner.study.growing import why_not
from bo_tuner.study.parts import IN_PROCESS, ROS
from bo_tuner.study.study import Study


def check_ends_early(study: Study, backend: str) -> None:
    """Refuse `cut_short` where nothing can end a run early.

    Parameters
    ----------
    study
        The study.
    backend
        Name of what runs the evaluations.

    Raises
    ------
    StudyError
        If that is so.
    """
    if not study.budget.cut_short or study.run is not None or backend == IN_PROCESS:
        return
    who = "a node that a service starts" if backend == ROS else "a function"
    raise StudyError(
        f"nothing ends a run of {who} early; expected a study with `run`, or with objects and "
        "--backend inprocess",
        ("budget", "cut_short"),
    )


@dataclass(frozen=True)
class CutShortBy:
    """By which metrics runs may be cut short, and by which not, with why."""

    metrics: tuple[str, ...]
    others: tuple[tuple[str, str], ...]


def decided_by(study: Study) -> CutShortBy:
    """Return by which metrics a run may be cut short, and by which not."""
    by = study.decisive_metrics
    others = {name: why_not(metric) for name, metric in study.metrics.items() if name not in by}
    return CutShortBy(tuple(by), tuple((name, why) for name, why in others.items() if why))
