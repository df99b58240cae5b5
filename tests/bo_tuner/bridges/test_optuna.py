"""Optuna's studies carry out a run, and are read as earlier runs."""

import optuna
import pytest

import bo_tuner as bt
from bo_tuner.bridges.optuna import BoTunerSampler, earlier_runs
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.trials import EvaluationState

RESULTS = ("trials.csv", "evaluations.csv", "best.yaml", "summary.json")

optuna.logging.set_verbosity(optuna.logging.ERROR)


def response(gain, load):
    """Error and peak; the error is least at a gain of 0.3."""
    return 1.0 + load * (gain - 0.3) ** 2, 2.0 * gain * load


def objective(trial):
    error, peak = response(trial.suggest_float("gain", 0.0, 1.0), trial.suggest_float("load", 1, 2))
    trial.set_user_attr("peak", peak)
    return error


@pytest.fixture
def study():
    return bt.Study(
        name="axis",
        parameters={"gain": bt.Double(0.0, 1.0, default=0.5)},
        contexts={"load": bt.Uniform(bounds=(1.0, 2.0))},
        metrics=["error", "peak"],
        objective="error",
        constraints={"peak": bt.WorstCase("peak", upper=1.0)},
        budget=bt.Budget(
            trials=4, initial_trials=3, drawn_contexts=2, search_evaluations=2, validation_draws=4
        ),
    )


def test_a_study_of_optuna_carries_out_the_run(study, tmp_path):
    """It is the same as that of `optimize`, and ends the study with it."""

    def function(parameters, context, seed):
        error, peak = response(parameters["gain"], context["load"])
        return {"error": error, "peak": peak}

    expected = study.optimize(function, tmp_path / "optimized", progress=False)
    sampler = BoTunerSampler(study, tmp_path / "sampled")
    of_optuna = optuna.create_study(sampler=sampler)
    of_optuna.optimize(objective)
    assert sampler.result().best == expected.best
    for name in RESULTS:
        found = (tmp_path / "sampled" / name).read_bytes()
        assert found == (tmp_path / "optimized" / name).read_bytes(), name
    evaluations = read_journal(tmp_path / "sampled" / "journal.sqlite").evaluations
    assert [t.params["load"] for t in of_optuna.trials] == [e.context["load"] for e in evaluations]
    with pytest.raises(bt.RunError, match="the run is over"):
        of_optuna.optimize(objective)


def test_pruned_failed_and_interrupted_trials(study, tmp_path):
    """A pruned one has failed for its parameters; the run of the others is made again."""
    seeds = []
    raised = iter([optuna.TrialPruned, KeyboardInterrupt, None, ZeroDivisionError, None])

    def fails(trial):
        seeds.append(sampler.run(trial).seed)
        if (error := next(raised)) is not None:
            raise error
        return objective(trial)

    sampler = BoTunerSampler(study, tmp_path / "run")
    of_optuna = optuna.create_study(sampler=sampler)
    with pytest.raises(KeyboardInterrupt):
        of_optuna.optimize(fails)
    of_optuna.optimize(fails, n_trials=3, catch=[ZeroDivisionError])
    assert (seeds[1], seeds[3]) == (seeds[2], seeds[4])
    found = read_journal(tmp_path / "run" / "journal.sqlite").evaluations
    lost = "the objective failed, returned no number, or was interrupted"
    assert [e.outcome.reason for e in found] == ["pruned", lost, "", lost, ""]
    assert [e.outcome.state for e in found[:2]] == [EvaluationState.FAILED, EvaluationState.LOST]
    sampler.close()
    study.tuner(tmp_path / "run").close()


@pytest.mark.parametrize(
    ("suggest", "said"),
    [
        (lambda trial: trial.suggest_float("gian", 0, 1), "gian: .* did you mean 'gain'"),
        (lambda trial: trial.suggest_float("gain", 3, 4), "gain: expected a range with .* 3 to 4"),
    ],
)
def test_what_the_study_does_not_have(study, suggest, said):
    of_optuna = optuna.create_study(sampler=BoTunerSampler(study))
    with pytest.raises(bt.StudyError, match=said):
        of_optuna.optimize(suggest)


def test_studies_that_do_not_fit(study):
    sampler = BoTunerSampler(study)
    for directions in (["maximize"], ["minimize", "minimize"]):
        found = ", ".join(directions)
        with pytest.raises(bt.StudyError, match=f"to minimize error, .* found .*: {found}$"):
            optuna.create_study(sampler=sampler, directions=directions).optimize(objective)
    enqueued = optuna.create_study(sampler=sampler)
    enqueued.enqueue_trial({"gain": 0.123})
    with pytest.raises(bt.StudyError, match=r"found 0\.123: trials cannot be enqueued"):
        enqueued.optimize(objective, n_trials=1)


@pytest.mark.filterwarnings("ignore::optuna.exceptions.ExperimentalWarning")
def test_parameters_cannot_be_fixed(study):
    sampler = optuna.samplers.PartialFixedSampler({"gain": 0.123}, BoTunerSampler(study))
    with pytest.raises(bt.StudyError, match=r"found 0\.123: .* nor parameters fixed"):
        optuna.create_study(sampler=sampler).optimize(objective, n_trials=1)


@pytest.mark.parametrize("left_out", ["gain", "load"])
def test_a_value_that_was_never_applied(study, tmp_path, left_out):
    def leaves_out(trial):
        names = {"gain": (0.0, 1.0), "load": (1.0, 2.0)}
        values = {n: trial.suggest_float(n, *r) for n, r in names.items() if n != left_out}
        error, peak = response(**{left_out: 1.0}, **values)
        trial.set_user_attr("peak", peak)
        return error

    of_optuna = optuna.create_study(sampler=BoTunerSampler(study, tmp_path / "run"))
    with pytest.raises(bt.StudyError, match=f"{left_out}: expected the objective to suggest it"):
        of_optuna.optimize(leaves_out)
    assert read_journal(tmp_path / "run" / "journal.sqlite").evaluations == ()


def test_choices():
    """A truth value is no number, and a text none of other texts."""
    study = bt.Study(
        name="modes",
        parameters={
            "mode": bt.Choice(["slow", "fast"], default="fast"),
            "filter": bt.Boolean(default=True),
        },
        metrics=["error"],
        objective="error",
        budget=bt.Budget(trials=4, initial_trials=3),
    )

    def suggests(filters, modes):
        def objective(trial):
            trial.suggest_categorical("filter", filters)
            return float(trial.suggest_categorical("mode", modes) == "fast")

        return objective

    of_optuna = optuna.create_study(sampler=BoTunerSampler(study))
    of_optuna.optimize(suggests([False, True], ["slow", "fast"]), n_trials=1)
    assert of_optuna.trials[0].params == {"filter": True, "mode": "fast"}
    for given, said in (
        (([0, 1], ["slow", "fast"]), "filter: expected choices with .*, found 0, 1"),
        (
            ([False, True], ["low", "high"]),
            "mode: expected choices with .*, found text 'low', text 'high'",
        ),
    ):
        with pytest.raises(bt.StudyError, match=said):
            optuna.create_study(sampler=BoTunerSampler(study)).optimize(suggests(*given))


def test_choices_that_are_no_texts(tmp_path):
    """They are texts in the study; of what is alike as text, a text comes first."""
    choices = [None, 1, "1", 2.5, False]
    study = bt.Study(
        name="modes",
        parameters={"mode": bt.Choice(["None", "1", "2.5", "False"], default="2.5")},
        metrics=["error"],
        objective={"metric": "error", "direction": "maximize"},
        budget=bt.Budget(trials=4, initial_trials=3),
    )
    of_optuna = optuna.create_study(direction="maximize", sampler=BoTunerSampler(study))
    of_optuna.optimize(lambda trial: float(trial.suggest_categorical("mode", choices) is None))
    shown = {repr(trial.params["mode"]) for trial in of_optuna.trials}
    assert {"2.5", "None"} <= shown <= {"None", "'1'", "2.5", "False"}
    assert of_optuna.sampler.result().best == {"mode": "None"}
    runs = earlier_runs(study, of_optuna)
    with study.tuner(tmp_path / "again", earlier=runs[:1]) as tuner:
        assert tuner.ask().trial == 1
    assert runs[0].parameters == {"mode": "2.5"}


def test_one_job_at_a_time(study):
    sampler = BoTunerSampler(study)
    of_optuna = optuna.create_study(sampler=sampler)
    first, second = of_optuna.ask(), of_optuna.ask()
    second.suggest_float("gain", 0.0, 1.0)
    with pytest.raises(bt.UnknownRunError, match=r"one job at a time \(n_jobs=1\)"):
        first.suggest_float("gain", 0.0, 1.0)


def test_a_metric_that_is_missing(study):
    of_optuna = optuna.create_study(sampler=BoTunerSampler(study))
    with pytest.raises(bt.MetricsError, match="metric peak is missing"):
        of_optuna.optimize(
            lambda trial: trial.suggest_float("gain", 0, 1) + trial.suggest_float("load", 1, 2)
        )


def test_its_trials_are_earlier_runs(study, tmp_path):
    of_optuna = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=1))
    of_optuna.optimize(objective, n_trials=3)
    with pytest.raises(ZeroDivisionError):
        of_optuna.optimize(lambda trial: 1 / 0)
    runs = earlier_runs(study, of_optuna)
    for run, trial in zip(runs, of_optuna.trials[:3], strict=True):
        assert run.parameters == {"gain": trial.params["gain"]}
        assert run.context == {"load": trial.params["load"]}
        assert run.metrics == {"error": trial.value, "peak": trial.user_attrs["peak"]}
    with study.tuner(tmp_path / "run", earlier=runs) as tuner:
        assert tuner.ask().trial == 3
