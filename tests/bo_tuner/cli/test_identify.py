"""The command `identify`: a study with narrower contexts, a misfit, and what it refuses."""

from dataclasses import replace
from functools import partial

import pytest
import yaml
from axis import node, write_study
from functions import NODE, FunctionBackend, make_study
from in_process import call, complaint
from made_runs import INITIAL, make_run

from bo_tuner.cli import identify
from bo_tuner.study.study_file import load_study

LOAD = 1.7
MACHINE = make_study(contexts={}, budget=INITIAL | {"trials": 1, "initial_trials": 1}, start=None)
NOISE = "(self.seed % 997) / 997"


def machine(gain, seed, shift=0.0):
    noise = 0.05 * (seed % 997) / 997
    return {"error": 1.0 + gain * LOAD + noise, "peak": LOAD - gain - noise + shift}


def write_simulator(folder, **sections):
    write_study(
        folder,
        make_study(nodes=node("identified_axis"), **sections),
        error=f"1.0 + self.gain * self.load + 0.05 * {NOISE}",
        peak=f"self.load - self.gain - 0.05 * {NOISE}",
    )


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the study of a simulator, and the run of a machine with the load 1.7."""
    write_simulator(tmp_path)
    make_run(tmp_path / "machine", MACHINE, FunctionBackend(MACHINE, machine))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def here(capsys):
    return partial(call, identify, capsys)


@pytest.fixture
def refusal(capsys):
    return partial(complaint, identify, capsys)


ASKED = ("machine", "--study", "./axis.yaml", "--output", "narrower.yaml")


def test_the_study_that_is_written(here, folder):
    code, out, err = here(*ASKED, "--figures", "plots")
    assert (code, err) == (0, "")
    earlier, narrower = load_study(folder / "axis.yaml"), load_study(folder / "narrower.yaml")
    load = narrower.contexts["load"].distribution
    assert load.lower < LOAD < load.upper
    assert load.width < 0.2
    assert replace(narrower, contexts=earlier.contexts) == earlier
    assert "where the machine is" in out
    assert "study: narrower.yaml" in out
    assert sorted(path.name for path in (folder / "plots").iterdir()) == [
        "contexts.png",
        "contexts.svg",
    ]


def test_a_misfit_is_said_and_nothing_is_written(here, folder):
    shifted = FunctionBackend(MACHINE, partial(machine, shift=3.0))
    make_run(folder / "other", MACHINE, shifted)
    code, out, _ = here("other", *ASKED[1:])
    assert code == 3
    assert "no context explains the runs of the machine, at a level of 0.01:" in out
    assert "peak: " in out
    assert not (folder / "narrower.yaml").exists()


def test_wider_contexts(here, folder):
    """The machine is outside of the box that it is to be certified in, and inside a wider one."""
    box = NODE | {"distribution": "uniform", "bounds": [1.0, 1.5]}
    write_simulator(folder, contexts={"load": box})
    assert here(*ASKED)[0] == 3
    wider = {"contexts": {"load": box | {"bounds": [0.5, 3.0]}}}
    (folder / "wider.yaml").write_text(yaml.safe_dump(wider))
    code, out, _ = here(*ASKED, "--contexts", "wider.yaml")
    assert code == 0
    assert "note: load is beyond the contexts of the study with a probability of 1\n" in out
    load = load_study(folder / "narrower.yaml").contexts["load"].distribution
    assert load.lower < LOAD < load.upper


class TestRefusals:
    @pytest.mark.parametrize(
        ("arguments", "complaint"),
        [
            (("--simulations", "3"), "--simulations: expected 10 to "),
            (("--credible", "1.5"), "argument --credible: 1.5: expected a number between 0 and 1"),
            (("--level", "no"), "argument --level: no: expected a number between 0 and 1"),
            (("--metrics", "error,force"), "expected some of error, peak, found 'force'"),
            (("--output", "./axis.yaml"), "--output: axis.yaml: is an input; give another name"),
            (("--output", ""), "--output: expected the name of a file"),
            (
                ("--output", "machine/journal.sqlite"),
                "--output: machine/journal.sqlite: is in a run folder; give another name",
            ),
            (("--output", "no/n.yaml"), "--output: no/n.yaml: there is no folder no"),
            (("--trial", "7"), "machine: has no complete run of trial 7"),
            (("--contexts", "nowhere.yaml"), "nowhere.yaml"),
        ],
    )
    def test_options(self, refusal, folder, arguments, complaint):
        assert complaint in refusal(*ASKED, *arguments)

    def test_no_run_and_no_study(self, refusal, folder):
        assert "nowhere: no such run folder" in refusal("nowhere", *ASKED[1:])
        assert "required: --study" in refusal("machine", "--output", "x.yaml")

    @pytest.mark.parametrize(
        ("content", "complaint"),
        [
            ("load: 3", "wider.yaml: expected a section contexts alone"),
            ("contexts: {}\nseed: 2", "wider.yaml: expected a section contexts alone"),
            ("contexts: {}", "has no contexts to infer"),
            ("contexts: {load: {node: axis, distribution: flat}}", "wider.yaml: contexts.load"),
            ("contexts: {load: {node: nobody, distribution: uniform, bounds: [1, 2]}}", "nobody"),
        ],
    )
    def test_wider_contexts(self, refusal, folder, content, complaint):
        (folder / "wider.yaml").write_text(content)
        assert complaint in refusal(*ASKED, "--contexts", "wider.yaml")

    def test_a_study_without_a_simulator(self, refusal, folder):
        study = yaml.safe_load((folder / "axis.yaml").read_text())
        del study["nodes"]["axis"]["object"]
        (folder / "axis.yaml").write_text(yaml.safe_dump(study))
        line = refusal(*ASKED)
        assert "./axis.yaml: has no simulator: node axis has no object; expected" in line

    def test_a_simulator_that_is_missing(self, refusal, folder):
        text = (folder / "axis.yaml").read_text()
        (folder / "axis.yaml").write_text(text.replace("identified_axis", "no_such_axis"))
        assert "cannot load no_such_axis:Axis" in refusal(*ASKED)

    def test_too_many_parameter_sets(self, refusal, folder):
        study = make_study(contexts={}, budget=INITIAL | {"trials": 21, "initial_trials": 21})
        make_run(folder / "many", study, FunctionBackend(study, machine))
        line = refusal("many", *ASKED[1:])
        assert "many: runs of 21 parameter sets; expected at most 20: name one by --trial" in line
