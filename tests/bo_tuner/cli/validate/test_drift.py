"""Whether the machine of a certificate has drifted: `validate --against`."""

import json

import pytest


@pytest.fixture
def certificate(here, folder):
    code, _, err = here(folder, "--runs", "120")
    assert code == 0, err
    return folder / "certificates" / "0001.json"


def drift(folder, number=1):
    return json.loads((folder / "drift" / f"{number:04d}.json").read_text())


def test_a_machine_as_before(here, folder, certificate):
    code, out, _ = here("--against", certificate)
    assert code == 0, out
    assert "no drift found" in out
    assert "false alarms: 5 % of such comparisons, over all metrics" in out
    assert " standard deviations is found within 20 runs in 95 % of cases" in out
    content = drift(folder)
    assert (content["drifted"], content["fresh"], content["failed"]) == ([], 20, 0)
    assert content["certificate"] == "0001.json"
    assert content["parameters"] == json.loads(certificate.read_text())["parameters"]
    assert {run["state"] for run in content["runs"]} == {"complete"}
    # Certificates are as before, and the next comparison has a number of its own.
    assert sorted(path.name for path in certificate.parent.iterdir()) == [
        "0001.json",
        "0001_evaluations.csv",
    ]
    assert here("--against", certificate)[0] == 0
    assert drift(folder, 2)["runs"][0]["seed"] != content["runs"][0]["seed"]


def test_a_drift(here, folder, certificate, monkeypatch):
    monkeypatch.setenv("PEAK", "0.6")
    code, out, _ = here("--against", certificate)
    assert code == 3
    assert "DRIFT: peak" in out
    content = drift(folder)
    assert content["drifted"] == ["peak"]
    assert content["fresh"] < 20
    # It is not seen in another metric.
    assert here("--against", certificate, "--metrics", "error")[0] == 0


def test_runs_that_fail(here, folder, certificate, monkeypatch):
    monkeypatch.setenv("FAILING", "1000")
    code, out, _ = here("--against", certificate)
    assert code == 3
    assert "fresh runs failed, and count as beyond every other" in out
    assert drift(folder)["metrics"][0]["fresh"] is None


def test_few_runs_say_that_they_see_nothing(here, certificate):
    code, out, _ = here("--against", certificate, "--runs", "1", "--false-alarms", "0.001")
    assert code == 0
    assert "1 run can hardly find any shift: allow more by --runs" in out


class TestRefusals:
    @pytest.mark.parametrize(
        ("arguments", "complaint"),
        [
            (["--confidence", "0.9"], "--confidence is not for --against"),
            (["--with-default"], "--with-default is not for --against"),
            (["--runs", "0"], "--runs: expected 1 to "),
            (["--false-alarms", "2"], "argument --false-alarms: 2: expected a number between 0"),
            (["--metrics", "force"], "--metrics: expected some of error, peak, found 'force'"),
            (["--backend", "ros"], "--backend: expected inprocess, as the certificate was made"),
        ],
    )
    def test_options(self, refusal, certificate, arguments, complaint):
        assert complaint in refusal("--against", certificate, *arguments)

    def test_a_run_is_named_by_its_certificate(self, refusal, folder, certificate):
        assert "RUN is not for --against" in refusal(folder, "--against", certificate)
        assert "--metrics needs --against" in refusal(folder, "--metrics", "error")
        assert "--false-alarms needs --against" in refusal(folder, "--false-alarms", "0.1")

    def test_what_is_no_certificate(self, refusal, folder, certificate):
        assert "expected a certificate in RUN/certificates" in refusal("--against", folder)
        assert "0002.json" in refusal("--against", certificate.with_name("0002.json"))

    def test_a_certificate_without_baseline_runs(self, refusal, certificate):
        certificate.with_name("0001_evaluations.csv").unlink()
        line = refusal("--against", certificate)
        assert "0001.json: has no baseline runs: its test runs cannot be read" in line
        assert "run validate again" in line
