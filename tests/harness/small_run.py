"""A whole run of a small object, made in this process."""

from axis import node
from functions import FunctionBackend, make_study

from bo_tuner.optimizers.algorithms import ALGORITHMS
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.parameter_file import node_values, to_yaml
from bo_tuner.storage.provenance import STUDY_YAML
from bo_tuner.storage.run_folder import BEST, JOURNAL, STUDY
from bo_tuner.study.study_file import study_to_yaml
from bo_tuner.tuning.journaling import JournalObserver
from bo_tuner.tuning.loop import Tuning


def make_run(folder, module="runs_axis", trials=3):
    """Write a run folder with a study that names the object, and a journal of its trials."""
    study = make_study(nodes=node(module)).replace(trials=trials)
    folder.mkdir()
    (folder / STUDY).write_text(study_to_yaml(study), encoding="utf-8")
    backend = FunctionBackend(
        study,
        lambda gain, load, seed: {"error": 25 * (gain - 0.3) ** 2 + load, "peak": 0.2},
    )
    provenance = {"algorithm": "IV", "backend": "inprocess", STUDY_YAML: study_to_yaml(study)}
    with Journal(folder / JOURNAL, provenance) as journal:
        observer = JournalObserver(journal)
        for trial in Tuning(study, backend, ALGORITHMS["IV"], observer=observer):
            journal.record_trial(trial)
    (folder / BEST).write_text(
        to_yaml(node_values(study, study.search_space().defaults)), encoding="utf-8"
    )
