"""A study with one wrong value at a time, and all that is said of it.

Whoever changes a message changes it in ``refused/faults.yaml``, where it is read.
"""

from pathlib import Path

import pytest

from bo_tuner.errors import StudyError
from bo_tuner.study import strict_yaml
from bo_tuner.study.study_file import study_from_mapping

HERE = Path(__file__).parent / "refused"
FAULTS = strict_yaml.parse((HERE / "faults.yaml").read_text()).value


def said(path, value):
    """Return all that is said of the study with a value in place of its own."""
    study = strict_yaml.parse((HERE / "study.yaml").read_text()).value
    *keys, last = path.split("/")
    inner = study
    for key in keys:
        inner = inner[key]
    inner[last] = value
    with pytest.raises(StudyError) as caught:
        study_from_mapping(study)
    return [str(error) for error in (caught.value, *caught.value.others)]


def test_the_study_itself_is_one():
    study_from_mapping(strict_yaml.parse((HERE / "study.yaml").read_text()).value)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault["at"])
def test_one_wrong_value(fault):
    assert said(fault["at"], fault["value"]) == fault["says"]
