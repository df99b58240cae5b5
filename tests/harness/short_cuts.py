"""The shipped study with cuts so short that their number makes the run, not their length."""

import json

from bo_tuner.study.study_file import load_study, study_to_mapping

SHORT = {"samples_per_level": 10}


def small_study(trials, *, plant=SHORT, controller=None, **budget):
    """Mapping of the benchmark with few evaluations, and parameters of its nodes.

    Unless the budget says otherwise, all trials are in the initial design, which no measured time
    can change.
    """
    sizes = {
        "initial_trials": trials,
        "drawn_contexts": 2,
        "search_evaluations": 2,
        "validation_draws": 2,
    }
    study = study_to_mapping(load_study("benchmark").replace(trials=trials, **sizes | budget))
    study["nodes"]["plant"]["parameters"] = plant
    study["nodes"]["controller"]["parameters"] = controller or {}
    return json.loads(json.dumps(study))
