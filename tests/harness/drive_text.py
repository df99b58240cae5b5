"""A study of a drive as the text of its file, and what is said of a wrong one."""

import pytest

from bo_tuner.errors import StudyError
from bo_tuner.study import strict_yaml
from bo_tuner.study.study_file import study_from_mapping

STUDY = """\
name: drive
nodes:
  drive: {node: drive, result: ~/cut_result}
parameters:
  gains.kp: {node: drive, type: double, bounds: [0, 10.0], default: 1}
  window: {node: drive, type: integer, bounds: [1, 9], default: 3, minimum_correlation: 0.1}
  span: {node: drive, type: integer, bounds: [1, 12], default: 4}
  echo: {node: drive, type: integer, tied_to: window}
  offset: {node: drive, type: double, fixed: 2}
order: [[window, span]]
contexts:
  load: {node: drive, distribution: uniform, bounds: [1, 2]}
seed_parameter: {node: drive, parameter: seed}
trigger: {node: drive, service: ~/run}
metrics:
  error: {node: drive}
  peak: {node: drive, key: peak_p99, unit: A}
objective: {metric: error}
constraints:
  current: {kind: chance, metric: peak, upper: 3, probability: 0.9}
  worst: {kind: worst_case, metric: peak, upper: 5}
budget: {trials: 12, initial_trials: 4}
"""


def mapping():
    return strict_yaml.parse(STUDY).value


def put(value, *path):
    """The study with a value put in."""
    changed = mapping()
    inner = changed
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return changed


def places(value, path=()):
    """Every path into dictionaries and lists."""
    yield path
    if isinstance(value, (dict, list)):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(inner, (*path, key))


def refusal(changed):
    with pytest.raises(StudyError) as caught:
        study_from_mapping(changed)
    text = str(caught.value)
    assert "\n" not in text
    return text
