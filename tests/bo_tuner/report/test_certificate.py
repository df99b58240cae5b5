"""A run with a certificate shows it, and a refused one before all else."""

import json

import pytest
from made_certificates import content_of, made_certificate

from bo_tuner.errors import RunRecordError
from bo_tuner.evidence.certificate.store import next_path
from bo_tuner.evidence.words.notebook import certificate_html
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.answer import answer
from bo_tuner.report.sections.certificate import certificate
from bo_tuner.report.sections.tolerance import tolerance


@pytest.fixture
def content(tuned):
    """Function that returns the content of a certificate: of a PASS, or of a FAIL."""

    def make(verdict, parameters=None):
        given = parameters or {"gain": 0.25}
        return content_of(tuned.study, made_certificate(tuned.study, given, verdict == "PASS"))

    return make


@pytest.fixture
def certified(tuned, tmp_path):
    """Function that gives the run a certificate with some content."""
    import dataclasses

    def give(text):
        path = next_path(tmp_path)
        path.write_text(text)
        return dataclasses.replace(tuned, path=tmp_path)

    return give


def test_a_run_without_a_certificate_has_none(tuned):
    assert certificate(tuned, None) is None


def test_its_numbers_are_shown(certified, content):
    found, section = certificate(certified(json.dumps(content("PASS"))), None)
    assert found.passed
    assert "97.5 % confidence of each bound" in certificate_html(found)
    limits, gaps = section.tables
    rows = {row[0].strip(): row[1:] for row in limits.rows}
    # It stands with the verdict.
    assert "mean error" not in rows
    assert rows["test runs above 1"] == ["8", "0", ""]
    assert rows["P(violation), 97.5 % bound"] == ["0.0123", "0.0123", ""]
    assert rows["97.5 % bound"] == ["0.77", "0.77", "N"]
    assert rows["at load"] == ["2", "2", ""]
    assert rows["test runs there above 1"] == ["1 of 30", "1 of 30", ""]
    assert rows["kept in every context"] == ["NOT proven", "proven", ""]
    assert rows["verdict"] == ["FAIL", "PASS", ""]
    assert gaps.rows == [["mean error", "1.2", "1.3", "1.5", "+0.3 ± 0.1", "s"]]
    assert any(note.startswith("peak drifts: of 112 test runs") for note in section.notes)
    assert "In force: kp, set on pid while it runs, and read back." in section.notes


def test_what_failed_before_is_told(certified, content):
    failed = {
        "contexts": [{"load": 1.25}],
        "certificate": "0001",
        "findings": content("FAIL")["tuned"],
    }
    earlier = {"refutations": [failed], "evaluations": 87, "unread": ["0002.json: damaged"]}
    text = json.dumps(content("PASS") | {"earlier": earlier})
    _, section = certificate(certified(text), None)
    told = (
        "This PASS covers it: the limits were shown anew in the context (load 1.25), and the "
        "earlier runs, which count against a PASS only, do not contradict."
    )
    (before,) = [note for note in section.notes if note.endswith(told)]
    assert before.startswith("Certificate 0001 was a FAIL (peak: 0 of 112 test runs violate")
    assert any("is missing: 0002.json: damaged" in note for note in section.notes)
    assert any("at least 0.14 of the box's edges" in note for note in section.notes)


@pytest.mark.parametrize("value", [1, 1.0, True])
@pytest.mark.parametrize(
    "place",
    [("objective", "unit"), ("training_gaps", 0, "name"), ("tuned", "constraints", 0, "name")],
)
def test_a_number_for_a_name_is_one_line(certified, content, place, value):
    changed = content("PASS")
    *path, last = place
    inside = changed
    for key in path:
        inside = inside[key]
    inside[last] = value
    with pytest.raises(RunRecordError, match=rf"{last}: expected text, found {str(value).lower()}"):
        certificate(certified(json.dumps(changed)), None)


def test_without_the_default_there_is_one_column(certified, content):
    _, section = certificate(certified(json.dumps(content("PASS") | {"default": None})), None)
    limits = section.tables[0]
    assert limits.header == ["", "tuned", "unit"]
    assert not any("mean error" in row[0] for row in limits.rows)


def band(median):
    return {"low": median - 0.1, "median": median, "high": median + 0.1}


def drift(bound):
    return {"bound": bound, "limit": band(bound), "breaks": 0.0}


def test_what_it_says_of_the_context_is_what_the_report_says(certified, content, tuned):
    """The certificate has more evaluations than the record of the run."""
    analysis = Analysis(tuned)
    assert "0.123" not in tolerance(analysis).lead
    drifts = {name: drift(1.0) for name in ("down", "up", "worst_down", "worst_up")}
    variable = {"name": "load", "unit": "kg", "nominal": 1.5, "relief": band(0.123)} | drifts
    found = {
        "constraint": "peak", "metric": "peak", "unit": "N", "limit": 1.0, "side": "upper",
        "evaluations": 1234, "nominal": band(0.5), "worst": band(0.9),
        "worst_context": {"load": 2.0}, "variables": [variable],
    }  # fmt: skip
    answer = dict(analysis.answer.parameters)
    ours = content("PASS", answer) | {"context_tolerances": [found]}
    section = tolerance(Analysis(certified(json.dumps(ours))))
    assert "by 0.123 N (0.023 to 0.223)" in section.lead
    assert "From 1234 test runs" in section.notes[0]


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"verdict": "PASS"}', "\x00"])
def test_a_broken_one_is_one_line(certified, text):
    with pytest.raises(RunRecordError, match=r"0001\.json: not a (readable )?certificate") as error:
        certificate(certified(text), None)
    assert "\n" not in str(error.value)


def test_a_certificate_of_another_version_does_not_keep_the_report_from_being_made(
    certified, content
):
    analysis = Analysis(certified(json.dumps(content("PASS") | {"format": 3})))
    assert analysis.certificate is None
    from report_runs import sections

    first = sections(analysis)[0]
    assert first.title == "Certificate: not readable"
    assert "0001.json: not a certificate of this version of bo_tuner; run validate" in first.lead
    said = [line.text for line in answer(analysis).trust if line.caution]
    assert "The certificate is not readable: run validate again" in said


def test_the_worst_case_is_shown_beside_a_parameter_set_without_one(certified, content):
    """There is no search for a default that the draws have refuted."""
    changed = content("PASS")
    changed["default"]["constraints"][0]["worst"] = []
    _, section = certificate(certified(json.dumps(changed)), None)
    rows = {row[0].strip(): row[1:] for row in section.tables[0].rows}
    assert rows["worst-case peak, mean"] == ["–", "0.75 ± 0.01", "N"]
    assert rows["at load"] == ["–", "2", ""]
    assert rows["test runs there above 1"] == ["–", "1 of 30", ""]
