"""Values that somebody else tuned, in the form in which a certificate takes them: without a run."""

from collections.abc import Mapping
from pathlib import Path

from bo_tuner.errors import RunRecordError
from bo_tuner.storage.record import RunRecord, record_of_study
from bo_tuner.storage.run_folder import JOURNAL, STUDY
from bo_tuner.study.changes import changes, summarized
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import Trial, TrialState, Value


def given_values(
    study: Study, values: Mapping[str, Value], folder: Path, backend: str
) -> tuple[RunRecord, Trial]:
    """Return a record without a trial, and the trial that stands for the values."""
    trial = Trial(0, study.complete_set(values), "given", TrialState.COMPLETE)
    return record_of_study(study, folder, backend), trial


def check_folder(record: RunRecord) -> None:
    """Refuse a folder of anything but certificates of given values by this study."""
    folder = record.path
    if (folder / JOURNAL).exists():
        raise RunRecordError(f"{folder}: is the folder of a run; name another one")
    if not (folder / STUDY).exists():
        return
    if lines := changes(load_study(str(folder / STUDY)), record.study):
        raise RunRecordError(
            f"{folder}: has certificates of another study: {summarized(lines)}; name another folder"
        )
