"""A whole run of a small object, made in this process."""

import made_runs
from axis import node
from functions import FunctionBackend, make_study

from bo_tuner.storage.parameter_file import node_values, to_yaml
from bo_tuner.storage.run_folder import BEST


def make_run(folder, module="runs_axis", trials=3):
    """Write a run folder with a study that names the object, and a journal of its trials."""
    study = make_study(nodes=node(module)).replace(trials=trials)
    backend = FunctionBackend(
        study,
        lambda gain, load, seed: {"error": 25 * (gain - 0.3) ** 2 + load, "peak": 0.2},
    )
    made_runs.make_run(folder, study, backend)
    (folder / BEST).write_text(
        to_yaml(node_values(study, study.search_space().defaults)), encoding="utf-8"
    )
