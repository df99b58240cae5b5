"""What to expect of the next drive, by drives that the search has not used.

If drives are exchangeable, as drives of one robot in one season are, a drive to come is as likely
as each of those at hand to be the worst one of all: with n unused ones, the next one is no worse
than all of them with probability n / (n + 1), on average over such sets. Of a given set less can be
said: with confidence 1 - α a share α^(1/n) of all drives is no worse than its worst one.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from scipy.special import betaincinv

from bo_tuner.codec.reading import JSON, read
from bo_tuner.codec.writing import to_json
from bo_tuner.errors import RunRecordError, StudyError
from bo_tuner.evidence.verdict import FAIL, PASS
from bo_tuner.numerics.sequential import spent
from bo_tuner.storage.atomic import write_atomically, writing
from bo_tuner.storage.numbered_files import next_number, numbered_path, numbered_paths
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_files import read_text
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial, Value

DRIVES = "drives"
"""Folder in a run folder with what was shown by drives that were not used."""
SHARE = 0.9
"""Share of the drives that must be within the limits, where the study asks for no probability."""


@dataclass(frozen=True)
class DriveRun:
    """The runs of a drive.

    Attributes
    ----------
    drive : str
        Its bag.
    tuned, default : mapping from str to float
        Metrics of the result and of the default; empty for a run that failed.
    beyond : tuple of str
        The limits that the result does not keep; all of them if its run failed.
    """

    drive: str
    tuned: Mapping[str, float]
    default: Mapping[str, float]
    beyond: tuple[str, ...]


@dataclass(frozen=True)
class NextDrive:
    """What drives that the search has not used show of those to come.

    Attributes
    ----------
    parameters : mapping
        The parameter set.
    runs : tuple of DriveRun
        One for each drive.
    confidence : float
        Confidence of this statement: all those of a run together have that of the study.
    asked : float
        Share of the drives that is to be within the limits.
    further : float
        Confidence of the next statement of the run.
    """

    parameters: Mapping[str, Value]
    runs: tuple[DriveRun, ...]
    confidence: float
    asked: float
    further: float

    @property
    def within(self) -> int:
        """How many drives are within all limits."""
        return sum(not run.beyond for run in self.runs)

    @property
    def shown(self) -> float:
        """Share of the drives that are within all limits at least, with the confidence."""
        return share_shown(self.within, len(self.runs), self.confidence)

    @property
    def passed(self) -> bool:
        """Whether that is what was asked for."""
        return self.shown >= self.asked

    @property
    def no_worse(self) -> float:
        """Share of all drives that are no worse than the worst one here, with the confidence."""
        return share_shown(len(self.runs), len(self.runs), self.confidence)

    @property
    def no_worse_on_average(self) -> float:
        """Probability that the next drive is no worse, on average over such sets of drives."""
        return len(self.runs) / (len(self.runs) + 1)

    @property
    def missing(self) -> int:
        """How many more drives within all limits would show it with these, in a further call."""
        count = len(self.runs)
        return least_drives(self.asked, self.further, count, count - self.within) - count


def share_shown(within: int, count: int, confidence: float) -> float:
    """Return the share of all that is within limits at least, if `within` of `count` are.

    The lower bound of C. J. Clopper and E. S. Pearson, Biometrika 26 (1934) 404-413.
    """
    if within == 0:
        return 0.0
    return float(betaincinv(within, count - within + 1, 1.0 - confidence))


def least_drives(asked: float, confidence: float, count: int = 1, beyond: int = 0) -> int:
    """Return how many drives show the share that is asked for; `count` at least.

    All but `beyond` of them are within the limits.
    """
    while share_shown(count - beyond, count, confidence) < asked:
        count += 1
    return count


def asked_of(study: Study) -> float:
    """Return the share of drives that the limits of a study ask for."""
    levels = [
        item.probability for item in study.constraints.values() if item.probability is not None
    ]
    return max(levels, default=SHARE)


def next_drive(
    study: Study,
    parameters: Mapping[str, Value],
    tuned: Sequence[Evaluation],
    default: Sequence[Evaluation],
    drives: Sequence[str],
    attempt: int,
) -> NextDrive:
    """Judge the runs of a parameter set, and of the default, on some drives, in their order."""
    runs = []
    for drive, mine, theirs in zip(drives, tuned, default, strict=True):
        values = mine.outcome.metrics if mine.outcome.complete else {}
        beyond = tuple(
            name
            for name, limit in study.constraints.items()
            if not values or bool(limit.violations(values[limit.metric]))
        )
        before = theirs.outcome.metrics if theirs.outcome.complete else {}
        runs.append(DriveRun(drive, dict(values), dict(before), beyond))
    confidence, further = (
        spent(study.certificate.confidence, number) for number in (attempt, attempt + 1)
    )
    return NextDrive(dict(parameters), tuple(runs), confidence, asked_of(study), further)


def attempt_in(folder: Path) -> int:
    """Return the number of the next statement in a run folder, from 1."""
    return next_number(folder / DRIVES)


def write_next_drive(folder: Path, number: int, made: NextDrive) -> Path:
    """Write a statement, and return the path; raises `OutputError` if it cannot be written."""
    directory = folder / DRIVES
    with writing(directory):
        directory.mkdir(exist_ok=True)
    content = {"passed": made.passed, "shown": made.shown, **to_json(made)}
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    return write_atomically(numbered_path(directory, number), text)


def drives_problem(record: RunRecord, trial: Trial) -> str:
    """Return in one line why no drives open `apply` to a parameter set; empty if some do.

    They do if the latest statement on it is a PASS. One by drives that are all within the limits,
    and too few, speaks neither for nor against it.
    """
    directory, problem = record.path / DRIVES, ""
    for path in numbered_paths(directory):
        try:
            made = read(NextDrive, json.loads(read_text(path)), JSON)
        except (RunRecordError, ValueError, StudyError) as error:
            # It may be a FAIL.
            return f"{path}: cannot be read: {error}"
        if made.parameters != trial.parameters:
            continue
        if made.passed:
            return ""
        problem = problem or f"{path}: expected {PASS}, found {FAIL}"
        if made.within < len(made.runs):
            return problem
    return problem or (
        f"{directory}: no drives that were not used are within the limits with trial "
        f"{trial.number}; run validate --drives BAG..."
    )
