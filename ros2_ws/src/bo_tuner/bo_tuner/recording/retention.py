"""Which bags stay: what is worth keeping of a run, within a limit of size."""

import contextlib
import math
import os
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import yaml

from bo_tuner.storage.run_files import open_file
from bo_tuner.study.limits import excess, tightest
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial, TrialState

MEGABYTE = 1_000_000
KEPT_AS = "kept_as"
BADNESS = "badness"
"""Keys of the custom data: why a bag is kept, and what the worst trial has most of."""


METADATA = "metadata.yaml"
MADE = "made.txt"
"""Names of the bags that the run has made, a line each: only these are ever deleted."""

BAG_NAME = re.compile(r"(trial|check)_\d{4,}(_part\d+)?|validation(_part\d+)?", re.ASCII)
"""Names that `bo_tuner.storage.run_files.bag_name` gives."""


class Policy(StrEnum):
    """Which trials' bags are kept."""

    ALL = "all"
    NOTABLE = "notable"
    NONE = "none"


class Reason(StrEnum):
    """What makes a bag notable."""

    BEST = "best so far"
    WORST = "worst"
    FAILED = "failed"
    EVIDENCE = "evidence for the recommendation"


@dataclass(frozen=True)
class RecordOptions:
    """What of a run is recorded.

    Attributes
    ----------
    policy
        Which bags are kept.
    limit
        Size of all bags together [byte].
    """

    policy: Policy = Policy.NOTABLE
    limit: int = 1000 * MEGABYTE


def badness(study: Study, trial: Trial) -> float:
    """How bad a complete trial is: its worst case, or its mean cost if the study has none."""
    if (tightest_constraint := tightest(study, trial)) is not None:
        return excess(*tightest_constraint)
    mean = trial.mean(study.objective.metric)
    return -math.inf if mean is None else float(study.objective.sign * mean)


def evaluation_badness(study: Study, evaluation: Evaluation) -> tuple[bool, float]:
    """How bad an evaluation is, as a key to sort by: a failed one is the worst.

    Else its worst-case metric counts, or in a study without one the objective as a cost.
    """
    metrics = evaluation.outcome.metrics
    if not evaluation.outcome.complete:
        return True, 0.0
    if worst := study.worst_case_constraints:
        return False, max(constraint.excess(metrics[constraint.metric]) for constraint in worst)
    return False, float(study.objective.to_cost(metrics[study.objective.metric]))


class Retention:
    """Deletes the bags of a run that shall not stay; what else is in the folder is left alone."""

    def __init__(self, folder: Path, options: RecordOptions) -> None:
        self._folder = folder
        self._options = options
        self._sizes: dict[str, int] = {}
        self._reasons: dict[str, str] = {}
        self._worst = float("-inf")
        # In the order of the list: a clock may be set, and a copy be newer than what it is of.
        for path in filter(is_bag, made_bags(folder)):
            data = custom_data(path)
            self._sizes[path.name] = _size(path)
            self._reasons[path.name] = data.get(KEPT_AS, "")
            with contextlib.suppress(KeyError, ValueError):
                self._worst = max(self._worst, float(data[BADNESS]))

    @property
    def kept(self) -> list[str]:
        """Names of the bags, oldest first."""
        return list(self._sizes)

    def reason(self, study: Study, trial: Trial, best: bool) -> Reason | None:
        """Return what makes a trial notable, if anything does."""
        if trial.state is TrialState.FAILED:
            return Reason.FAILED
        if trial.state is TrialState.CUT_SHORT:
            return None
        if best:
            return Reason.BEST
        return Reason.WORST if badness(study, trial) > self._worst else None

    def wants(self, reason: Reason | None) -> bool:
        """Whether a trial's bag is to be kept at all."""
        return reason is not None or self._options.policy is Policy.ALL

    def keep(self, path: Path, reason: Reason | None, value: float | None) -> list[str]:
        """Take a whole bag in, and delete what it displaces."""
        displaced = []
        size, limit = _size(path), self._options.limit
        beside = sum(self._sizes[name] for name in self._best())
        if reason != Reason.BEST and size + beside > limit:
            # All others would go for it, and then it would, too.
            shutil.rmtree(path, ignore_errors=True)
            displaced.append(path.name)
        else:
            self._displace_worst(value)
            self._sizes[path.name] = size
            self._reasons[path.name] = reason or ""
        best = self._best()
        for name in self.kept:
            if sum(self._sizes.values()) <= limit:
                break
            if name not in best:
                self._delete(name)
                displaced.append(name)
        return displaced

    def _best(self) -> list[str]:
        """Return the name of the bag of the present best, if there is one."""
        return [name for name in self.kept if self._reasons[name] == Reason.BEST][-1:]

    def _displace_worst(self, value: float | None) -> None:
        """Note how bad a new trial is, and if none is as bad let the bag of the worst go."""
        if value is None or value <= self._worst:
            return
        self._worst = value
        if self._options.policy is Policy.NOTABLE:
            for name in [n for n, r in self._reasons.items() if r == Reason.WORST]:
                self._delete(name)

    def _delete(self, name: str) -> None:
        shutil.rmtree(self._folder / name, ignore_errors=True)
        del self._sizes[name], self._reasons[name]


def note_bag(path: Path) -> None:
    """Take down that the run makes a bag."""
    descriptor = open_file(path.with_name(MADE), os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(f"{path.name}\n")


def made_bags(folder: Path) -> list[Path]:
    """List the bags that a run has made, those included that are gone; none is a link."""
    try:
        descriptor = open_file(folder / MADE, os.O_RDONLY)
    except FileNotFoundError:
        return []
    with os.fdopen(descriptor, encoding="utf-8", errors="replace") as file:
        lines = [line.strip() for line in file]
    # A name may have been made again: what counts is the last time.
    names = reversed(dict.fromkeys(reversed(lines)))
    # No name leads out of the folder.
    bags = [folder / name for name in names if BAG_NAME.fullmatch(name)]
    return [bag for bag in bags if not bag.is_symlink()]


def is_bag(path: Path) -> bool:
    """Whether a path is that of a bag, and not of one that is still being written."""
    return (path / METADATA).is_file()


def custom_data(bag: Path) -> Mapping[str, str]:
    """Read the custom data of a bag; empty if its metadata cannot be read."""
    try:
        metadata = yaml.safe_load((bag / METADATA).read_text(encoding="utf-8"))
        data = metadata["rosbag2_bagfile_information"]["custom_data"]
        return {str(key): str(value) for key, value in data.items()}
    except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError, UnicodeDecodeError):
        return {}


def _size(bag: Path) -> int:
    return sum(path.stat().st_size for path in bag.rglob("*") if path.is_file())
