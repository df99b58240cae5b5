"""Which parameters were seen to move a metric, by the trials of a run, and where that is said."""

import json

import numpy as np
import pytest
from functions import NODE, failed, make_study
from report_runs import run_axis
from threadpoolctl import threadpool_limits

from bo_tuner.codec.reading import JSON, read
from bo_tuner.codec.writing import to_json
from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.evidence.words.effects import effects_in_words, file_notes
from bo_tuner.evidence.words.verdict import sentences
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.page import answer_html
from bo_tuner.report.sections.effects import effects
from bo_tuner.storage.parameter_file import from_yaml
from bo_tuner.storage.record import read_run
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage, Trial, TrialState
from bo_tuner.tuning.effects import ERROR, FAILURES, ParameterEffects, effects_in
from bo_tuner.tuning.summary import summary_from_record

GAIN = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
LAW = NODE | {"type": "string", "choices": ["a", "b", "c"], "default": "b"}


@pytest.fixture(autouse=True)
def one_thread():
    with threadpool_limits(1):
        yield


def trials_of(study, function, count, seed=0):
    """Trials at random places, each with an evaluation in a random context."""
    rng, space, contexts = np.random.default_rng(seed), study.search_space(), study.context_space()
    found = []
    for number in range(count):
        parameters = space.to_parameters(space.repair(rng.random((1, space.dimension)))[0])
        (context,) = (contexts.to_dict(row) for row in contexts.draw(1, rng))
        said = function(rng, **{n: parameters[n] for n in space.names}, **context)
        outcome = said
        if not isinstance(said, Outcome):
            outcome = Outcome(EvaluationState.COMPLETE, said)
        evaluation = Evaluation(number, 0, Stage.DRAWN, parameters, context, number, outcome)
        state = TrialState.COMPLETE if outcome.complete else TrialState.FAILED
        found.append(Trial(number, parameters, "", state, evaluations=(evaluation,)))
    return found


def seen(effects):
    return {
        item.parameter: [effect.metric for effect in item.effects if effect.seen]
        for item in effects
    }


def test_what_moves_and_what_does_not():
    study = make_study(parameters={"kp": GAIN, "law": LAW, "dead": GAIN, "off": LAW})

    def function(rng, kp, law, load, **_):
        jump = {"a": 0.0, "b": 1.0, "c": 0.0}[law]
        error = 3.0 * (kp - 0.4) ** 2 + 5.0 * load + 0.02 * rng.normal()
        return {"error": error, "peak": jump + 0.02 * rng.normal()}

    effects = effects_in(study, trials_of(study, function, 40))
    assert seen(effects) == {"kp": ["error"], "law": ["peak"], "dead": [], "off": []}
    assert [item.unseen for item in effects] == [False, False, True, True]
    jump = next(e for e in effects[1].effects if e.metric == "peak")
    assert abs(jump.change) == pytest.approx(1.0, abs=0.1)


def test_false_alarms_of_all_parameters_together():
    study = make_study(parameters={"kp": GAIN, "ki": GAIN, "kd": GAIN})

    def function(rng, kp, load, **_):
        return {"error": kp**2 + load + 0.2 * rng.normal(), "peak": rng.normal()}

    runs, alarms = 40, 0
    for seed in range(runs):
        found = seen(effects_in(study, trials_of(study, function, 20, seed)))
        alarms += any((found["ki"], found["kd"], "peak" in found["kp"]))
    assert alarms <= runs * ERROR + 3.0 * np.sqrt(runs * ERROR * (1.0 - ERROR))


def test_failures_alone_are_an_effect():
    study = make_study(parameters={"kp": GAIN, "ki": GAIN})

    def function(rng, kp, **_):
        metrics = {"error": 1.0 + 0.01 * rng.normal(), "peak": 0.5}
        return failed("axis: unstable") if kp > 0.6 else metrics

    effects = effects_in(study, trials_of(study, function, 30))
    assert seen(effects) == {"kp": [FAILURES], "ki": []}


def test_a_metric_that_explodes_does_not_hide_an_effect():
    study = make_study(parameters={"kp": GAIN, "ki": GAIN})

    def function(rng, kp, ki, **_):
        wild = 1e6 if ki > 0.95 else 0.0
        return {"error": kp + wild + 0.02 * rng.normal(), "peak": 0.5}

    effects = effects_in(study, trials_of(study, function, 40))
    assert "error" in seen(effects)["kp"]


def test_too_few_trials_tell_nothing():
    study = make_study(parameters={"kp": GAIN, "ki": GAIN})
    effects = effects_in(study, trials_of(study, lambda rng, **_: noise(rng), 4))
    assert [(item.seen, item.conclusive) for item in effects] == [(False, False)] * 2
    assert effects_in_words(study, effects) == (
        "The trials are too few to tell whether kp and ki move a metric.",
    )
    assert file_notes(study, effects) == ()
    assert effects_in(study, []) == ()


def noise(rng):
    return {"error": 1.0 + rng.normal(), "peak": 0.5 + rng.normal()}


def test_all_trials_failed():
    study = make_study()
    effects = effects_in(study, trials_of(study, lambda _, **__: failed("no"), 5))
    assert [(item.seen, item.conclusive) for item in effects] == [(False, False)]


def test_without_noise_and_without_an_effect():
    study = make_study(parameters={"kp": GAIN})
    effects = effects_in(study, trials_of(study, lambda *_, **__: {"error": 2.0, "peak": 0.5}, 8))
    assert effects_in_words(study, effects) == (
        "kp was not seen to move any metric (any effect on error and peak would have been seen).",
        "axis may read kp only while it starts: with at_start: true under nodes.axis the tuner "
        "starts it with the values of each trial. Otherwise the runs do not depend on it: leave it "
        "fixed.",
    )
    assert file_notes(study, effects) == (
        "kp of axis: not seen to move any metric (any effect on error and peak would have been "
        "seen)",
    )


def test_a_summary_holds_them():
    study = make_study(parameters={"kp": GAIN, "ki": GAIN})
    effects = effects_in(study, trials_of(study, lambda rng, **_: noise(rng), 12))
    text = json.dumps(to_json(effects), allow_nan=False)
    assert read(tuple[ParameterEffects, ...], json.loads(text), JSON) == effects


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The object knows no parameter `idle`, and takes it all the same."""
    budget = {
        "trials": 12,
        "initial_trials": 8,
        "drawn_contexts": 2,
        "search_evaluations": 2,
        "validation_draws": 3,
    }
    path = run_axis(
        tmp_path_factory.mktemp("idle"),
        parameters={"gain": GAIN, "idle": {**GAIN, "bounds": [0.0, 1.0]}},
        budget=budget,
    )
    return read_run(path)


def test_every_screen_and_file_of_a_run_says_it(run):
    verdict = run_verdict(run)
    assert [item.parameter for item in verdict.unseen] == ["idle"]
    (sentence,) = [text for text in sentences(verdict) if "was not seen to move" in text]
    assert sentence.startswith("idle was not seen to move any metric (an")
    (note,) = file_notes(run.study, verdict.unseen)
    for name in ("best.yaml", "deploy/parameters.yaml"):
        text = (run.path / name).read_text()
        assert text.splitlines()[0] == f"# {note}"
        assert from_yaml(text)["axis"].keys() == {"gain", "idle"}
    summary = json.loads((run.path / "summary.json").read_text())
    assert [item["parameter"] for item in summary["effects"]] == ["gain", "idle"]
    assert summary["verdict"]["unseen_parameters"] == ["idle"]
    assert sentence in summary["verdict"]["sentences"]
    # The live page shows this part of the report.
    assert sentence.split(" (")[0] in answer_html(Analysis(run))
    section = effects(Analysis(run))
    assert sentence in section.lead
    assert "most by idle" not in section.lead


def test_a_summary_made_from_the_journal_says_the_same(run):
    assert summary_from_record(run)["effects"] == run.summary["effects"]
