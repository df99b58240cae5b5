"""The same study with another search space: other bounds, or fewer tuned parameters."""

import dataclasses
from collections.abc import Mapping

from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.errors import StudyError
from bo_tuner.study.activity import Activity
from bo_tuner.study.parameter import Number
from bo_tuner.study.study import Study
from bo_tuner.trials import Value


def with_bounds(study: Study, bounds: Mapping[str, tuple[Number, Number]]) -> Study:
    """Return the study with other bounds of some tuned numbers.

    Parameters
    ----------
    study
        The study.
    bounds : mapping from str to tuple of two numbers
        Smallest and largest value, in the parameter's unit, by its name.

    Raises
    ------
    StudyError
        If there is no such tuned number, or its bounds violate a rule.
    """
    parameters = dict(study.parameters)
    for name, pair in bounds.items():
        checks.reference(name, "parameter", parameters)
        item = parameters[name]
        if item.bounds is None:
            raise StudyError("has no bounds; expected a tuned number", (name,))
        with under("parameters", name):
            parameters[name] = dataclasses.replace(item, bounds=pair)
    return dataclasses.replace(study, parameters=parameters)


def with_fixed(study: Study, values: Mapping[str, Value]) -> Study:
    """Return the study with some tuned parameters kept at a value.

    What `start` and `park` say of these is left out, and what is never active with them is fixed as
    well.

    Raises
    ------
    StudyError
        If there is no such tuned parameter, or it cannot have the value.
    """
    parameters = dict(study.parameters)
    for name in values:
        checks.reference(name, "parameter", parameters)
        if not parameters[name].is_tuned:
            raise StudyError("is not tuned", (name,))
    complete = study.complete_set(values)
    for name in values:
        parameters[name] = parameters[name].fixed_at(complete[name])
    for name in Activity(parameters).never_active():
        if parameters[name].is_tuned:
            parameters[name] = parameters[name].fixed_at(complete[name])
    fixed = {name for name, item in parameters.items() if not item.is_tuned}
    start = tuple(
        given
        if isinstance(given, str)
        else {name: value for name, value in given.items() if name not in fixed}
        for given in study.start
    )
    kept = {k: value for k, value in study.park.parameters.items() if k not in fixed}
    park = dataclasses.replace(study.park, parameters=kept)
    return dataclasses.replace(study, parameters=parameters, start=start, park=park)
