"""Whatever stands in a study: it is a study, or one printable line."""

import copy

import numpy as np
import pytest
from drive_text import mapping, places, put
from hypothesis import given, settings
from hypothesis import strategies as st

from bo_tuner.errors import StudyError
from bo_tuner.study.study_file import (
    parse_study,
    study_from_mapping,
    study_to_yaml,
)

PLACES = [path for path in places(mapping()) if path]
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 30),
    st.integers(),
    st.floats(),
    st.sampled_from([10**5000, 2**63, 5e-324, 1.7e308, -1.7e308, 1e300]),
    st.text(max_size=6),
    st.sampled_from(["window", "span", "drive", "error", "integer", "double", "beta", "discrete"]),
    st.lists(st.floats() | st.integers() | st.text(max_size=3), max_size=3),
    st.lists(st.floats(-1e308, 1e308).map(abs), min_size=2, max_size=2).map(sorted),
    st.dictionaries(st.text(max_size=4) | st.integers(), st.integers(), max_size=2),
)
DISTRIBUTION_FIELDS = st.fixed_dictionaries(
    {"distribution": st.sampled_from(["truncated_normal", "uniform", "beta", "triangular"])},
    optional={
        "bounds": st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=2).map(sorted),
        **{key: st.floats(1e-9, 1e9) for key in ("mean", "standard_deviation", "a", "b", "mode")},
    },
)


class TestFuzz:
    @given(st.lists(st.tuples(st.sampled_from(PLACES), VALUES, st.booleans()), max_size=3))
    @settings(max_examples=400)
    def test_a_study_or_one_line(self, edits):
        changed = copy.deepcopy(mapping())
        for path, value, remove in edits:
            inner = changed
            for key in path[:-1]:
                try:
                    inner = inner[key]
                except (KeyError, IndexError, TypeError):
                    break
            else:
                if isinstance(inner, dict) or (
                    isinstance(inner, list) and isinstance(path[-1], int) and path[-1] < len(inner)
                ):
                    inner[path[-1]] = value
                    if remove and isinstance(inner, dict):
                        del inner[path[-1]]
        self.study_or_line(changed)

    @given(VALUES)
    @settings(max_examples=30)
    def test_any_value(self, value):
        self.study_or_line(value)

    @given(DISTRIBUTION_FIELDS)
    @settings(max_examples=150)
    def test_any_distribution(self, fields):
        self.study_or_line(put({"node": "drive"} | fields, "contexts", "load"))

    @given(st.text(max_size=40) | st.text("abc:[]{}-,'\"|>&*!%# \n\t", max_size=40))
    @settings(max_examples=300)
    def test_any_text(self, text):
        with pytest.raises(StudyError) as caught:
            parse_study(text, "mine.yaml")
        assert str(caught.value).isprintable()

    @staticmethod
    def study_or_line(value):
        problem = ""
        try:
            study = study_from_mapping(value)
        except StudyError as error:
            problem = str(error)
        if problem:
            assert problem.isprintable()
            return
        assert parse_study(study_to_yaml(study)) == study
        space = study.search_space()
        rng = np.random.default_rng(0)
        for point in space.latin_hypercube(3, rng):
            space.key(space.to_parameters(point))
        contexts = study.context_space()
        drawn = contexts.draw(3, rng)
        assert np.all((drawn >= contexts.lower) & (drawn <= contexts.upper))
