"""A PASS after a FAIL covers what failed, and says so everywhere."""

import html
import json

import pytest
from validated_run import certificate


@pytest.fixture
def failed(here, folder, monkeypatch):
    """The run after a FAIL: draws keep the limit of 1 in the mean, the upper end does not.

    The mean is the value set, and 0.05 times the load, which is between 1 and 2.
    """
    monkeypatch.setenv("PEAK", "0.92")
    assert here(folder)[0] == 3
    content = certificate(folder)
    assert content["tuned"]["constraints"][0]["worst"]
    monkeypatch.delenv("PEAK")
    return content


def test_it_covers_what_failed(here, folder, failed):
    code, out, err = here(folder)
    assert code == 0, err
    assert "tuned: certificate 0001 was a FAIL; its " in err
    assert "its runs count against a PASS" in err
    (reason,) = failed["reasons"]
    found = certificate(folder, 2)
    (refuted,) = found["earlier"]["refutations"]
    assert refuted["certificate"] == "0001"
    covered = [w["context"] for w in found["tuned"]["constraints"][0]["worst"]]
    assert refuted["contexts"]
    assert all(context in covered for context in refuted["contexts"])
    said = f"Certificate 0001 was a FAIL ({reason}). This PASS covers it: "
    assert said in out
    summary = json.loads((folder / "summary.json").read_text())
    assert any(sentence.startswith(said) for sentence in summary["verdict"]["sentences"])
    assert "This PASS covers it: " in (folder / "report.html").read_text()


def test_after_a_fail_a_fail_names_the_one_before(here, folder, failed, monkeypatch):
    monkeypatch.setenv("PEAK", "0.92")
    code, out, _ = here(folder)
    assert code == 3
    assert "Certificate 0001 was a FAIL (" in out
    assert "covers" not in out


def test_it_says_what_the_search_would_have_found(here, folder):
    assert here(folder)[0] == 0
    widths = certificate(folder)["search_widths"]
    assert [item["probability"] for item in widths] == [0.9, 0.5]
    assert 0.0 < widths[1]["width"] < widths[0]["width"] < 0.2
    assert "of the box's edges in width would have been found with a probability of 90 %" in (
        html.unescape((folder / "report.html").read_text())
    )
