from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bo_tuner.methods.boundary.repetition import NEAR, OwnRuns, lacking, next_repetition
from bo_tuner.models.categories import Coding
from bo_tuner.models.pooled_process import PooledProcess
from bo_tuner.models.pooled_responses import EveryContext, PooledResponse
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.trials import Stage

SPREAD = 0.05
OWN = OwnRuns()


class Stress(PooledResponse):
    """The parameter itself, with the same variance everywhere, which is also that of a run."""

    limit, sign = 1.0, 1.0

    def on_runs(self, level):
        return self

    def predict(self, x):
        return self.forecast(x)[:2]

    def forecast(self, x):
        return x[:, 0], np.full(len(x), SPREAD**2), np.full(len(x), SPREAD**2)

    def deviation_of_run(self, x):
        return np.full(len(x), SPREAD)


class Cost:
    """What is lacking to the parameter, without doubt."""

    scale = 1.0

    def predict(self, x):
        return -x[:, 0], np.full(len(x), 1e-12)


@pytest.fixture
def study(make_study):
    return make_study(
        parameters={"x": {"node": "axis", "type": "double", "bounds": [0.0, 1.0], "default": 0.0}}
    )


@pytest.fixture
def candidate(make_trial):
    def make(number, x, feasibility):
        return Candidate(make_trial(number, {"x": x}, [1.0]), 0.0, feasibility, 0.0, 0.0, -x, 0.975)

    return make


def test_what_no_budget_shows_is_not_run_again(study, candidate):
    """The better one has the larger product of gain and probability, but hardly ever is shown."""
    surrogates = SimpleNamespace(limits=(Stress(),), objective=Cost())
    best, sure, close = candidate(0, 0.9, 0.98), candidate(1, 0.93, 0.92), candidate(2, 0.985, 0.62)
    assert (0.985 - 0.9) * close.feasibility > (0.93 - 0.9) * sure.feasibility
    chosen = next_repetition(study, surrogates, [best, close, sure], 40, OWN)
    assert chosen.trial.number == 1
    assert chosen.runs == 2


def test_nothing_is_run_again_for_a_negligible_gain(study, candidate):
    surrogates = SimpleNamespace(limits=(Stress(),), objective=Cost())
    best, other = candidate(0, 0.9, 0.98), candidate(1, 0.9005, 0.97)
    assert next_repetition(study, surrogates, [best, other], 40, OWN) is None


def test_without_an_answer_the_most_provable_one_is_run_again(study, candidate):
    surrogates = SimpleNamespace(limits=(Stress(),), objective=Cost())
    open_ones = [candidate(k, x, 0.5) for k, x in enumerate((0.99, 0.95, 0.97))]
    assert next_repetition(study, surrogates, open_ones, 40, OWN).trial.number == 1


@pytest.fixture
def constraint(study):
    """Far from its limit, but a model can be wrong."""
    rng = np.random.default_rng(0)
    contexts = study.context_space()
    x, c = rng.random((60, 1)), rng.random((60, contexts.dimension))
    y = x[:, 0] + rng.normal(0.0, 0.1, 60)
    process = PooledProcess.fit(x, c, y, coding=Coding((0,)), rng=rng)
    return EveryContext(process, 5.0, contexts.candidates())


def repeated(study, constraint, best, contexts):
    """What is repeated next after an answer has been run in the contexts (m, e) of the cube."""
    space = study.context_space()
    (evaluation,) = best.trial.evaluations
    checks = tuple(
        replace(evaluation, stage=Stage.CHECK_WORST, context=space.to_dict(row))
        for row in space.to_contexts(contexts)
    )
    surrogates = SimpleNamespace(limits=(constraint,), objective=Cost())
    answer = replace(best, trial=replace(best.trial, evaluations=checks))
    return next_repetition(study, surrogates, [answer], 40, OWN)


@pytest.mark.parametrize("done", [0, OWN.doubtful - 1])
def test_an_answer_has_runs_of_its_own_one_at_a_time(study, candidate, constraint, done):
    best = candidate(0, 0.95, 0.98)
    (row,), _ = constraint.most_doubtful(np.array([[0.95]]))
    doubtful = constraint.contexts[row]
    found = repeated(study, constraint, best, np.tile(doubtful, (done, 1)))
    assert found.runs == 1
    assert study.context_space().cube_of([found.context]) == pytest.approx(doubtful[None])


def test_an_answer_has_been_run_in_every_corner_and_no_more(study, candidate, constraint):
    """Where its limit is most doubtful may move then."""
    best = candidate(0, 0.95, 0.98)
    space = study.context_space()
    corners = space.corners()
    (row,), _ = constraint.most_doubtful(np.array([[0.95]]))
    done = np.tile(constraint.contexts[row], (OWN.doubtful, 1))
    for _ in range(len(corners)):
        found = repeated(study, constraint, best, done)
        if found is None:
            break
        there = space.cube_of([found.context])
        assert found.runs == 1
        assert (there == corners).all(axis=1).any()
        assert (np.abs(done - there) > NEAR).any(axis=1).all()
        done = np.vstack([done, there])
    apart = np.abs(corners[:, None] - done).max(axis=2)
    assert (apart.min(axis=1) <= NEAR).all()
    assert repeated(study, constraint, best, done) is None


def test_a_challenger_is_run_before_an_answer_and_leaves_it_its_own_runs(
    study, candidate, constraint
):
    """An answer that is to be replaced needs none; and the one that stays must get its own."""
    surrogates = SimpleNamespace(limits=(constraint,), objective=Cost())
    best, better = candidate(0, 0.5, 0.98), candidate(1, 0.9, 0.9)
    own = len(lacking(study, surrogates, best.trial, OWN))
    assert own > OWN.doubtful
    for left in range(1, 4 * own):
        found = next_repetition(study, surrogates, [best, better], left, OWN)
        if left >= 2 + own:
            assert (found.trial.number, found.runs) == (1, 2)
        else:
            assert (found.trial.number, found.runs) == (0, 1)


def test_no_challenger_is_run_that_could_not_get_its_own_runs(study, candidate, constraint):
    """It would be shown to be better, and be passed over for the answer that has its own."""
    surrogates = SimpleNamespace(limits=(constraint,), objective=Cost())
    best, better = candidate(0, 0.5, 0.98), candidate(1, 0.9, 0.9)
    while own := lacking(study, surrogates, best.trial, OWN):
        best = with_own_run(best, own[0])
    own = len(lacking(study, surrogates, better.trial, OWN))
    for left in range(1, 2 * own):
        found = next_repetition(study, surrogates, [best, better], left, OWN)
        assert (found is not None) == (left >= own)


def test_where_nothing_is_shown_all_runs_are_for_challengers(study, candidate, constraint):
    surrogates = SimpleNamespace(limits=(constraint,), objective=Cost())
    open_ones = [candidate(0, 0.5, 0.9), candidate(1, 0.9, 0.9)]
    for left in (1, 2, 20):
        assert next_repetition(study, surrogates, open_ones, left, OWN) is not None


def with_own_run(candidate, context):
    (evaluation, *_) = candidate.trial.evaluations
    own = replace(evaluation, stage=Stage.CHECK_WORST, context=context)
    trial = candidate.trial
    return replace(candidate, trial=replace(trial, evaluations=(*trial.evaluations, own)))


@pytest.mark.parametrize(("variables", "corners"), [(3, 8), (4, 0)])
def test_many_corners_are_not_run(make_study, candidate, variables, corners):
    context = {"node": "axis", "distribution": "uniform", "bounds": [0.0, 1.0]}
    study = make_study(
        parameters={"x": {"node": "axis", "type": "double", "bounds": [0.0, 1.0], "default": 0.0}},
        contexts={f"c{k}": context for k in range(variables)},
    )
    rng = np.random.default_rng(0)
    x, c = rng.random((80, 1)), rng.random((80, variables))
    process = PooledProcess.fit(x, c, c[:, 0], coding=Coding((0,)), rng=rng)
    # The most doubtful context is no corner.
    inside = np.full((1, variables), 0.6)
    constraint = EveryContext(process, 5.0, inside)
    best = candidate(0, 0.95, 0.98)
    done = np.tile(inside, (OWN.doubtful, 1))
    for _ in range(16):
        found = repeated(study, constraint, best, done)
        if found is None:
            break
        done = np.vstack([done, list(found.context.values())])
    assert len(np.unique(done, axis=0)) - 1 == corners


def test_without_contexts_there_are_no_corners(make_study, candidate, constraint):
    study = make_study(
        parameters={"x": {"node": "axis", "type": "double", "bounds": [0.0, 1.0], "default": 0.0}},
        contexts={},
    )
    everywhere = replace(constraint, contexts=np.empty((1, 0)))
    process = PooledProcess.fit(
        np.linspace(0.0, 1.0, 9)[:, None], np.empty((9, 0)), np.linspace(0.0, 1.0, 9),
        coding=Coding((0,)), rng=np.random.default_rng(0),
    )  # fmt: skip
    everywhere = replace(everywhere, process=process)
    best = candidate(0, 0.95, 0.98)
    assert repeated(study, everywhere, best, np.empty((OWN.doubtful, 0))) is None
