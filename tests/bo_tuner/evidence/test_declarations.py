"""What runs contradict: a range, a scale, and that they are alike."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bo_tuner.evidence.declarations import contradicted, drifts, two_kinds, uneven
from bo_tuner.evidence.facts import NoLogarithm
from bo_tuner.metrics.collect import judged
from bo_tuner.processor_load import Load
from bo_tuner.run_notes import Notes, Rate
from bo_tuner.study.ranges import OutOfRange
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage

NODE = {"node": "axis"}


def runs(study, peaks):
    """Test runs with these values of a metric, as a collector judges them."""
    outcomes = (
        judged(study, Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": float(peak)}))
        for peak in peaks
    )
    return [
        Evaluation(1, k, Stage.VALIDATION, {"gain": 0.5}, {"load": 1.5}, k, outcome)
        for k, outcome in enumerate(outcomes)
    ]


def test_a_run_outside_its_range(make_study):
    study = make_study(metrics={"error": NODE, "peak": NODE | {"range": [0.0, 2.0]}})
    assert [*contradicted(study, runs(study, [0.5, 2.0]))] == []
    (found,) = contradicted(study, runs(study, [0.5, 2.5]))
    assert found.how == OutOfRange("peak", 2.5, 0.0, 2.0)


def test_equal_runs_with_messages_at_different_rates(make_study):
    """Of a simulator that does not wait; each signal is named once, other sets are no matter."""

    def made(trial, gain, messages, drive=""):
        rate = Rate(messages, 5.0 / messages, 6.0 / messages, 0.1, 5.0)
        notes = Notes(rates={"angle": rate, "event": None, "speed": rate})
        outcome = Outcome(EvaluationState.COMPLETE, {}, load=Load(0.0, None), notes=notes)
        return Evaluation(trial, 0, Stage.DRAWN, {"gain": gain}, {"drive": drive}, 1, outcome)

    study = make_study()
    assert not [*uneven(study, [made(1, 0.5, 250), made(2, 0.7, 160), made(1, 0.5, 245)])]
    runs = [made(1, 0.5, 250), made(1, 0.5, 78), made(2, 0.7, 250), made(2, 0.7, 160)]
    (found,) = uneven(study, runs)
    assert (found.first.signal, found.others) == ("angle", ("speed",))
    assert (found.first.least, found.first.most) == pytest.approx((78 / 5, 250 / 5))

    # A bag has its own gaps.
    plays = SimpleNamespace(bag_in=lambda context: context["drive"])
    assert not [*uneven(plays, [made(1, 0.5, 250, "a"), made(1, 0.5, 160, "b")])]
    assert [*uneven(plays, [made(1, 0.5, 250, "a"), made(1, 0.5, 160, "a")])]


def test_values_without_a_logarithm(make_study):
    study = make_study(metrics={"error": NODE, "peak": NODE | {"scale": "log"}})
    assert [*contradicted(study, runs(study, [0.5, 0.1]))] == []
    assert [*contradicted(study, runs(study, [0.5, 0.0, -1.0]))] == [
        NoLogarithm("peak", "metrics.peak", 2)
    ]
    study = make_study(objective={"metric": "error", "scale": "log"})
    (zero,) = runs(study, [1.0])
    failed = judged(study, Outcome(EvaluationState.COMPLETE, {"error": 0.0, "peak": 1.0}))
    assert [*contradicted(study, [replace(zero, outcome=failed)])] == [
        NoLogarithm("error", "objective", 1)
    ]


@pytest.mark.parametrize(
    ("of", "in_scatter", "rises"),
    [
        (lambda noise, time: noise + 3.0 * time, False, True),
        (lambda noise, time: noise - 3.0 * time, False, False),
        (lambda noise, time: noise * np.exp(4.0 * time), True, True),
        (lambda noise, time: noise * np.exp(-4.0 * time), True, False),
    ],
)
def test_a_drift_is_found(make_study, of, in_scatter, rises):
    study, noise = make_study(), np.random.default_rng(3).standard_normal(40)
    peaks = of(noise, np.linspace(0.0, 1.0, 40))
    (found,) = drifts(study, {"tuned": runs(study, peaks)})
    assert (found.title, found.whose, found.runs) == ("peak", "tuned", 40)
    assert (found.in_scatter, found.correlation > 0.0) == (in_scatter, rises)
    assert found.p_value < 0.01


def test_runs_that_are_alike_seldom_seem_to_drift(make_study):
    """1 % of 300 sets of runs with heavy tails, at most; 8 or more have a probability of 0.01."""
    study, rng = make_study(), np.random.default_rng(4)
    named = sum(
        bool([*drifts(study, {"tuned": runs(study, rng.standard_t(2.0, 25))})]) for _ in range(300)
    )
    assert named < 8


def test_equal_runs_and_rounding_are_no_drift(make_study):
    study = make_study()
    assert [*drifts(study, {"tuned": runs(study, 0.3 + 1e-16 * np.arange(40.0))})] == []
    assert [*drifts(study, {"tuned": [], "default": runs(study, [0.5])})] == []


@pytest.mark.parametrize("declared", [False, True])
def test_two_kinds_are_found(make_study, declared):
    metrics = {"error": NODE, "peak": NODE | ({"range": [0.0, 9.0]} if declared else {})}
    study, rng = make_study(metrics=metrics), np.random.default_rng(4)
    peaks = np.where(np.arange(30) % 3, 0.5, 2.0) + 0.02 * rng.standard_normal(30)
    (found,) = two_kinds(study, {"tuned": runs(study, peaks)})
    assert (found.metric, found.whose) == ("peak", "tuned")
    assert (found.above[0], found.below[0]) == (10, 20)
    assert found.below[1] == pytest.approx(0.5, abs=0.02)
    assert found.needs_range is not declared
    assert [*two_kinds(study, {"tuned": runs(study, rng.normal(0.5, 0.1, 40))})] == []


def test_values_of_discrete_contexts_are_no_kinds(make_study):
    """The peak is 0.5 in one room and 2 in the other."""
    rooms = {"node": "axis", "distribution": "discrete", "values": ["office", "yard"]}
    study, rng = make_study(contexts={"room": rooms}), np.random.default_rng(5)
    known = runs(study, np.tile([0.5, 2.0], 20) + 0.02 * rng.standard_normal(40))
    by_room = [replace(e, context={"room": rooms["values"][e.index % 2]}) for e in known]
    assert [*two_kinds(study, {"tuned": by_room})] == []
    together = [replace(e, context={"room": "yard"}) for e in known]
    assert len([*two_kinds(study, {"tuned": together})]) == 1
