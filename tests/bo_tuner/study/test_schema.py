"""The schema and the page of all keys of a study file are those of the classes that check it."""

import json
from pathlib import Path

import jsonschema
import pytest

from bo_tuner.codec.reading import keys_of
from bo_tuner.codec.schema import texts_of
from bo_tuner.errors import StudyError
from bo_tuner.package_files import config_directory
from bo_tuner.study import schema, strict_yaml
from bo_tuner.study.study_file import study_from_mapping

ROOT = Path(__file__).parents[3]
SCHEMA = schema.schema()
STUDIES = [
    *(ROOT / "ros2_ws" / "src").glob("*/config/studies/*.yaml"),
    *(ROOT / "examples").glob("*/study.yaml"),
]


def study():
    text = (ROOT / "ros2_ws/src/bo_tuner/config/studies/benchmark.yaml").read_text()
    return strict_yaml.parse(text).value


def is_valid(mapping):
    return jsonschema.Draft202012Validator(SCHEMA).is_valid(mapping)


def test_the_files_are_up_to_date():
    """Otherwise: python -m bo_tuner.study.schema SCHEMA PAGE."""
    assert json.loads((config_directory() / "study.schema.json").read_text()) == SCHEMA
    assert (ROOT / "docs" / "study_file.md").read_text() == schema.page()


def test_it_is_a_schema():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: f"{path.parts[-4]}/{path.name}")
def test_studies_that_the_tuner_takes(path):
    assert is_valid(strict_yaml.parse(path.read_text()).value)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("budgets",), {}),
        (("budget", "trials"), "many"),
        (("parameters", "lambda_mpc", "bound"), [0, 1]),
        (("parameters", "lambda_mpc", "type"), "float"),
        (("parameters", "lambda_mpc", "bounds"), [0.0, 1.0, 2.0]),
        (("contexts", "damping_factor", "distribution"), "normal"),
        (("contexts", "damping_factor", "mode"), 1.0),
        (("metrics", "overshoot", "keys"), "peak"),
        (("run",), {"end": {"after": "soon"}}),
        (("run",), {"end": {"after": 1.0}, "start": [{"shout": {}}]}),
    ],
)
def test_mistakes_that_an_editor_shows(path, value):
    """The tuner refuses them as well."""
    mapping = study()
    at = mapping
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    assert not is_valid(mapping)
    with pytest.raises(StudyError):
        study_from_mapping(mapping)


def test_every_key_has_a_text():
    for title, cls in schema._sections():
        texts = texts_of(cls)
        assert all(texts.values()), title
        assert {field.name for field in keys_of(cls)} <= texts.keys(), title
