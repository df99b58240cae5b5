"""A certificate on disk is the one that was written, or it is refused in a line."""

import copy
import json
import math

import pytest
from judged_runs import certify
from made_certificates import content_of, made_certificate

from bo_tuner.errors import RunRecordError
from bo_tuner.evidence.certificate.store import (
    latest_certificate,
    next_path,
    read_certificate,
)
from bo_tuner.evidence.certificate_file import certificate_text

WRONG = (
    None, True, -1, 0, 10**400, 1e308, math.nan, math.inf, "", "x", "\ud800", [], [1], [None], {},
    {"x": 1}, {"": None},
)  # fmt: skip


def places(document, path=()):
    """Yield where the values of a document are."""
    items = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in items:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


def changed(document, place, value):
    document = copy.deepcopy(document)
    *path, last = place
    inside = document
    for key in path:
        inside = inside[key]
    inside[last] = value
    return document


@pytest.fixture
def content(tuned):
    return content_of(tuned.study, made_certificate(tuned.study, {"gain": 0.25}))


@pytest.fixture
def read(tuned, tmp_path):
    """Function that reads some content as a certificate of the run."""

    def read(content):
        path = next_path(tmp_path)
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        try:
            return read_certificate(path, tuned.study)
        finally:
            path.unlink()

    return read


def test_what_was_written_is_read_back(run):
    """With what the search, the model and the provenance of a real one have."""
    draws = [(1.0, 0.5 + 0.001 * k) for k in range(40)]
    written = certify(run, draws, draws, repeated=40)
    path = latest_certificate(run, run.trials[run.summary["trial"]])
    found = read_certificate(path, run.study)
    # As text, since NaN differs from itself.
    assert repr(found) == repr(written)
    assert certificate_text(run.study, found) == path.read_text()
    assert found.context_tolerances
    assert found.parameter_sensitivity is not None


def test_whatever_a_value_is_replaced_by_is_read_or_refused_in_a_line(content, read):
    refusals = []
    for place in places(content):
        for value in WRONG:
            try:
                read(changed(content, place, value))
            except RunRecordError as error:
                refusals.append(str(error))
    assert len(refusals) > 1000
    assert all(text.count("\n") == 0 and text.endswith("run validate") for text in refusals)


def test_a_bound_without_enough_runs_is_infinite_on_its_side(content, read):
    mean = ("tuned", "constraints", 0, "worst", 0, "mean")
    found = read(changed(changed(content, (*mean, "upper"), None), (*mean, "lower"), None))
    (worst,) = found.tuned.constraints[0].worst
    assert (worst.mean.upper, worst.mean.lower) == (math.inf, -math.inf)


@pytest.mark.parametrize(
    ("place", "value", "complaint"),
    [
        (("tuned", "constraints", 0, "name"), "p", "constraints: expected peak, found p"),
        (("tuned", "constraints"), [], "constraints: expected peak, found none"),
        (("tuned", "parameters"), {"x": 1.0}, "parameters: expected gain, found x"),
        (
            ("tuned", "constraints", 0, "worst", 0, "context"), {"wear": 1.0},
            "contexts of peak: expected load, found wear",
        ),
        (("seen",), {"wind": {"low": 0.0, "high": 1.0, "mean": 0.5}}, "seen: expected of"),
        (("format",), 5, "not a certificate of this version of bo_tuner; run validate"),
    ],
)  # fmt: skip
def test_one_of_another_study_or_version_is_refused(content, read, place, value, complaint):
    with pytest.raises(RunRecordError, match=complaint):
        read(changed(content, place, value))


def test_a_verdict_that_does_not_follow_from_its_findings_is_refused(content, read):
    failed = changed(content, ("tuned", "constraints", 0, "passed"), False)
    with pytest.raises(RunRecordError, match="verdict: expected FAIL by its findings, found text"):
        read(failed)
    assert read(changed(failed, ("verdict",), "FAIL")).verdict == "FAIL"
