"""Values that somebody else tuned, without a run; the verdict for CI servers."""

from functools import partial
from xml.etree import ElementTree

import pytest
from axis import node, write_study
from in_process import call, complaint
from validated_run import CHANCE, certificate

from bo_tuner.cli import validate as validate_command
from bo_tuner.evidence.certificate.store import read_certificate
from bo_tuner.interruption import Interrupted
from bo_tuner.study.study_file import load_study

# The peak is 0.5 + gain times the load, which is at most 2: the limit of 1 holds up to 0.25.
PEAK = "0.5 + self.gain * self.load"


@pytest.fixture
def place(tmp_path, make_study, monkeypatch):
    """Folder with a study, its object and two files of values: one keeps the limit."""
    study = make_study(name="axis", nodes=node("given_axis"), constraints=CHANCE)
    write_study(tmp_path, study, peak=PEAK)
    (tmp_path / "good.yaml").write_text("gain: 0.2\n")
    (tmp_path / "bad.yaml").write_text("gain: 0.3\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.fixture
def here(place, capsys):
    """Function that certifies a file of values of the study; returns code, out and err."""
    backend = ("--backend", "inprocess", "--study", "axis.yaml")
    return partial(call, validate_command, capsys, *backend, "--parameters")


@pytest.fixture
def refusal(place, capsys):
    return partial(complaint, validate_command, capsys, "--backend", "inprocess")


def cases(file):
    """The test cases by name: what is wrong with each, as the name and text of its mark."""
    (suite,) = ElementTree.parse(file).getroot()
    marks = {case.get("name"): [(m.tag, m.get("message")) for m in case] for case in suite}
    marks.pop(None, None)
    assert suite.get("tests") == str(len(marks))
    for kind in ("failure", "error"):
        counted = sum(mark[0] == kind for item in marks.values() for mark in item)
        assert suite.get(f"{kind}s") == str(counted)
    return marks


def test_values_that_keep_the_limits(here, place):
    code, out, err = here("good.yaml", "--junit", "report.xml")
    assert code == 0, err
    assert out.startswith("PASS: ")
    assert "this run" not in out
    assert "apply" not in out + err
    folder = place / "runs" / "axis-given"
    content = certificate(folder)
    assert content["parameters"] == {"gain": 0.2}
    assert cases("report.xml") == {"peak": [], "error": [], "all limits": []}
    assert read_certificate(folder / "certificates" / "0001.json", load_study("axis.yaml")).passed


def test_values_that_do_not(here, place):
    code, out, err = here("bad.yaml", "--output", "certified", "--junit", "report.xml")
    assert code == 3, err
    assert "tune --study" in out
    found = cases("report.xml")
    ((kind, message),) = found["peak"]
    assert (kind, message) == (
        "failure",
        "NOT proven to be kept by the mean over noise in every context",
    )
    ((kind, message),) = found["all limits"]
    assert kind == "failure"
    assert message in out
    text = ElementTree.parse("report.xml").find(".//testcase[@name='peak']/failure").text
    # 0.5 + 0.3 * 2, in the worst context.
    assert "worst-case peak 1.1, limit 1" in text


def test_certificates_in_a_folder_share_the_confidence(here, place):
    assert here("bad.yaml", "--output", "certified")[0] == 3
    assert here("good.yaml", "--output", "certified")[0] == 0
    first, second = (certificate(place / "certified", number) for number in (1, 2))
    assert (first["attempt"], second["attempt"]) == (1, 2)
    assert first["bound_confidence"] < second["bound_confidence"]


def test_it_goes_on_after_an_interruption(here, place, monkeypatch):
    from bo_tuner.backends.inprocess import InProcessBackend

    outcome, calls = InProcessBackend.outcome, []

    def stop(self, planned):
        calls.append(planned.seed)
        if len(calls) == 5:
            raise Interrupted(2)
        return outcome(self, planned)

    monkeypatch.setattr(InProcessBackend, "outcome", stop)
    code, _, err = here("good.yaml", "--junit", "report.xml")
    assert code == 130
    assert "continue with: validate --backend inprocess --study axis.yaml --parameters good" in err
    assert {mark for ((mark, _),) in cases("report.xml").values()} == {"error"}
    code, _, err = here("good.yaml", "--junit", "report.xml")
    assert code == 0, err
    assert "after 4 test runs" in err
    assert len(calls) == len(set(calls)) + 1
    assert cases("report.xml")["all limits"] == []


def test_with_the_default(here, place):
    code, out, err = here("good.yaml", "--with-default")
    assert code == 0, err
    assert "The default does not stay within all limits: peak: " in out


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ([], "the following arguments are required: RUN, or --parameters and --study"),
        (["--parameters", "good.yaml"], "--parameters needs --study"),
        (["--study", "axis.yaml"], "--study needs --parameters"),
        (["runs/x", "--output", "x"], "--output needs --parameters"),
        (["runs/x", "--parameters", "good.yaml"], "in place of a run; leave runs/x out"),
        (
            ["--parameters", "good.yaml", "--study", "axis.yaml", "--trial", "1"],
            "--trial is of a run; leave it out with --parameters",
        ),
        (
            ["--parameters", "good.yaml", "--study", "axis.yaml", "--until-pass", "2"],
            "--until-pass is of a run",
        ),
        (["--parameters", "nothing.yaml", "--study", "axis.yaml"], "nothing.yaml: "),
        (["--parameters", "good.yaml", "--study", "nothing.yaml"], "nothing.yaml: "),
        (
            ["--parameters", "good.yaml", "--study", "axis.yaml", "--junit", "nowhere/x.xml"],
            "nowhere/x.xml: cannot be written",
        ),
        (
            ["--parameters", "good.yaml", "--study", "axis.yaml", "--junit", ""],
            ".: cannot be written: Is a directory",
        ),
        (
            ["--parameters", "good.yaml", "--study", "axis.yaml", "--junit", "good.yaml"],
            "good.yaml: is no XML file; expected one, or the name of a new file",
        ),
    ],
)
def test_bad_input(refusal, place, arguments, complaint):
    assert complaint in refusal(*arguments)
    assert not (place / "runs").exists()
    assert (place / "good.yaml").read_text() == "gain: 0.2\n"


def test_values_that_are_no_parameter_set(refusal, place):
    (place / "other.yaml").write_text("gian: 0.2\n")
    assert "gian" in refusal("--parameters", "other.yaml", "--study", "axis.yaml")


def test_a_folder_of_something_else(here, refusal, place, make_study):
    assert here("bad.yaml", "--output", "certified")[0] == 3
    given = ("--parameters", "good.yaml", "--study", "axis.yaml", "--output")
    (place / "run").mkdir()
    (place / "run" / "journal.sqlite").touch()
    assert "run: is the folder of a run; name another one" in refusal(*given, "run")
    other = make_study(name="axis", nodes=node("given_axis"), constraints=CHANCE, seed=9)
    write_study(place, other, peak=PEAK)
    line = refusal(*given, "certified")
    assert "certified: has certificates of another study: seed " in line
