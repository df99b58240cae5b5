"""The shipped study with cuts so short that their number makes the run, not their length."""

import json

from bo_tuner.study.study_file import load_study, study_to_mapping

SHORT = {"samples_per_level": 10}


def small_study(trials, **plant_parameters):
    """The benchmark with all trials in the initial design, which no measured time can change."""
    study = study_to_mapping(
        load_study("benchmark").replace(
            trials=trials,
            initial_trials=trials,
            drawn_contexts=2,
            search_evaluations=2,
            validation_draws=2,
        )
    )
    study["nodes"]["plant"]["parameters"] = SHORT | plant_parameters
    return json.loads(json.dumps(study))
