"""Values that somebody else tuned, in the form in which a certificate takes them: without a run."""

from collections.abc import Mapping
from pathlib import Path

from bo_tuner.storage.record import RunRecord, record_of_study
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState, Value


def given_values(
    study: Study, values: Mapping[str, Value], folder: Path, backend: str
) -> tuple[RunRecord, Trial]:
    """Return a record without a trial, and the trial that stands for the values.

    Parameters
    ----------
    study
        The study.
    values
        By name; what is left out is the default.
    folder
        Where the certificates are kept.
    backend
        On which they are made.

    Raises
    ------
    StudyError
        If the values are no parameter set of the study.
    """
    trial = Trial(0, study.complete_set(values), "given", TrialState.COMPLETE)
    return record_of_study(study, folder, backend), trial
