"""Runs around the default that show what each parameter does, on functions in closed form."""

import numpy as np
import pytest
from functions import NODE, failed, make_study

from bo_tuner.cli.parameter_runs import show_effects, try_parameters
from bo_tuner.errors import RunError
from bo_tuner.numerics.linear_effects import POWER
from bo_tuner.trials import Evaluation, EvaluationState, Stage
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.effects import ERROR, FAILURES
from bo_tuner.tuning.variations import MOST_SINGLY, judge, order_of_runs, plan

GAIN = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
KINDS = {
    "gain": GAIN,
    "weight": NODE | {"type": "double", "bounds": [0.01, 100.0], "default": 1.0, "scale": "log"},
    "horizon": NODE | {"type": "integer", "bounds": [2, 15], "default": 9},
    "taps": NODE | {"type": "integer", "bounds": [1, 10], "step": 4, "default": 1},
    "fast": NODE | {"type": "boolean", "default": True},
    "law": NODE | {"type": "string", "choices": ["a", "b", "c"], "default": "b"},
    "follower": NODE | {"type": "double", "tied_to": "gain"},
    "other": NODE | {"type": "double", "fixed": 3.0},
}


def gains(count):
    return {f"gain{k}": GAIN for k in range(count)}


def study_of(parameters, **sections):
    return make_study(parameters=parameters, contexts=None, constraints={}, **sections)


def noisy(function, scale=0.1):
    """A node whose error is that of a function, with noise by the seed."""

    def said(seed, **values):
        noise = scale * np.random.default_rng(seed).normal(size=2)
        return {"error": function(**values) + noise[0], "peak": noise[1]}

    return said


def tried(study, backend, **options):
    """The default twice, and what is planned around it."""
    defaults, options = study.search_space().defaults, {"whole_range": True} | options
    done = list(
        backend.run([Evaluation(0, k, Stage.NOMINAL, defaults, {}, 10**6 + k) for k in range(2)])
    )
    planned, runs = try_parameters(study, Driver(backend), done, wait=1.0, **options)
    return planned, runs, judge(study, planned, runs)


def test_the_ends_of_each_range_one_at_a_time():
    found = plan(study_of(KINDS), whole_range=True)
    assert found.values == {
        "gain": (0.0, 1.0),
        "weight": (0.01, 100.0),
        "horizon": (2, 15),
        # 9 is the last one with the step of 4; the default is the lower end.
        "taps": (9,),
        "fast": (False,),
        "law": ("a", "c"),
    }
    assert {variation.runs for variation in found.variations} == {2}
    defaults = study_of(KINDS).search_space().defaults
    for variation in found.variations:
        changed = {n for n, v in variation.parameters.items() if v != defaults[n]}
        assert changed - {"follower"} == {variation.moved}
        assert variation.parameters["follower"] == variation.parameters["gain"]


def test_small_steps_of_numbers_alone():
    """5 % of the range on its scale, or one of an integer; what has no step is left alone."""
    found = plan(study_of(KINDS), whole_range=False)
    weights = 10.0 ** (4.0 * 0.05)
    assert found.values == {
        "gain": (pytest.approx(0.45), pytest.approx(0.55)),
        "weight": (pytest.approx(1.0 / weights), pytest.approx(weights)),
        "horizon": (8, 10),
        "taps": (5,),
    }


def test_the_order_of_parameters_is_kept():
    study = study_of({"low": GAIN, "high": GAIN | {"default": 0.8}}, order=[["low", "high"]])
    found = plan(study, whole_range=True)
    assert found.values == {"low": (0.0, 0.8), "high": (0.5, 1.0)}
    equal = study_of({"low": GAIN, "high": GAIN}, order=[["low", "high"]])
    assert plan(equal, whole_range=True).values == {"low": (0.0,), "high": (1.0,)}


@pytest.mark.parametrize(("whole_range", "levels"), [(True, (0.25, 0.75)), (False, (0.45, 0.55))])
def test_many_numbers_are_moved_at_once(whole_range, levels):
    """Half of the way to the ends, or by a step; choices still one at a time."""
    count = MOST_SINGLY + 1
    study = study_of(gains(count) | {"law": KINDS["law"]})
    found = plan(study, whole_range=whole_range)
    assert found.screened == tuple(gains(count))
    assert all(found.values[n] == pytest.approx(levels) for n in found.screened)
    at_once = [v for v in found.variations if not v.moved]
    assert len(at_once) == 24, "twice 12, the first design with more than 9 columns"
    assert found.runs == 24 + (4 if whole_range else 0)
    rows = np.array([[v.parameters[n] for n in found.screened] for v in at_once])
    np.testing.assert_allclose(rows.mean(axis=0), 0.5)


def test_the_runs_are_in_random_order():
    """All of them, the default among them."""
    study = study_of(gains(3))
    found = plan(study, whole_range=True)
    order = order_of_runs(study, found, 6)
    assert sorted(order, key=str) == sorted([None] * 6 + 2 * list(range(6)), key=str)
    assert order != sorted(order, key=str)


def test_what_moves_and_what_does_not(function_backend):
    study = study_of({"kp": GAIN, "ki": GAIN})
    backend = function_backend(study, noisy(lambda kp, ki: 4.0 * (kp - 0.2), 0.1))
    _, runs, found = tried(study, backend)
    assert len(runs.default) == 8
    assert {name: item.effects.seen for name, item in found.items()} == {"kp": True, "ki": False}
    (move,) = found["kp"].moves
    assert (move.effect.metric, move.value) in [("error", 0.0), ("error", 1.0)]
    # 2 from the default to either end.
    assert abs(move.effect.change) == pytest.approx(2.0, abs=0.3)
    assert move.noise == pytest.approx(0.1, rel=0.8)
    assert found["ki"].effects.unseen


@pytest.mark.parametrize("count", [2, 10])
def test_false_alarms(count, function_backend):
    """All parameters together at most 5 %, whatever noise the live one brings with it."""
    study = study_of(gains(count))
    alarms, runs = 0, 40
    for number in range(runs):

        def function(seed, gain0, number=number, **_):
            rng = np.random.default_rng([seed, number])
            return {"error": 9.0 * gain0 + rng.normal(), "peak": (1.0 + gain0) * rng.normal()}

        _, _, found = tried(study, function_backend(study, function))
        alarms += any(item.effects.seen for name, item in found.items() if name != "gain0")
        assert found["gain0"].effects.effects[0].seen or count == 2
    assert alarms <= runs * ERROR + 3.0 * np.sqrt(runs * ERROR * (1.0 - ERROR))


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 10])
def test_an_effect_of_the_smallest_size_would_have_been_seen(count, function_backend):
    """What the runs say would have been seen is, in other runs of the same noise."""
    study = study_of(gains(count))
    seen, runs = 0, 40
    for number in range(runs):
        # The median over many runs, so that the size belongs to the noise and not to one estimate.
        sizes = SIZES.setdefault(count, _sizes(study, function_backend))
        # Seen at one end alone, or in the screening design over half the range.
        slope = sizes if count == 2 else sizes / 0.5

        def function(seed, gain1, number=number, slope=slope, **_):
            rng = np.random.default_rng([seed, number, 1])
            effect = slope * (max(2.0 * gain1 - 1.0, 0.0) if count == 2 else gain1)
            return {"error": effect + rng.normal(), "peak": 0.0}

        _, _, found = tried(study, function_backend(study, function))
        seen += found["gain1"].effects.effects[0].seen
    assert seen / runs >= POWER - 3.0 * np.sqrt(POWER * (1.0 - POWER) / runs)
    # Nor is it much too large.
    assert sizes < 9.0


SIZES = {}


def _sizes(study, function_backend):
    found = []
    for number in range(20):

        def function(seed, number=number, **_):
            return {"error": np.random.default_rng([seed, number, 2]).normal(), "peak": 0.0}

        _, _, each = tried(study, function_backend(study, function))
        found.append(each["gain1"].effects.effects[0].visible)
    # By the mean square, as the noise itself is estimated.
    return float(np.sqrt(np.mean(np.square(found))))


def test_without_noise(function_backend, capsys):
    study = study_of({"kp": GAIN, "ki": GAIN})
    backend = function_backend(study, lambda kp, **_: {"error": 2.0 + kp, "peak": 3.0})
    planned, runs, found = tried(study, backend)
    assert show_effects(study, planned, runs, whole_range=True)
    assert found["kp"].effects.seen
    assert found["ki"].effects.unseen
    out, err = capsys.readouterr()
    assert "(any effect on error and peak would have been seen)" in err
    # A node that takes one parameter while it runs is not told to be started anew for another.
    assert "axis takes other values while it runs, as kp moved a metric" in out
    assert "at_start" not in out


def test_nothing_moves_anything(function_backend, capsys):
    study = study_of({"kp": GAIN, "ki": GAIN})
    planned, runs, _ = tried(study, function_backend(study, noisy(lambda **_: 1.0)))
    assert not show_effects(study, planned, runs, whole_range=True)
    err = capsys.readouterr().err
    assert err.count("error: k") == 2
    assert "kp was not seen to move any metric (an effect above " in err
    assert "tried: 0 and 1, beside the default 0.5" in err


def test_in_small_steps_that_is_no_error(function_backend, capsys):
    """An effect of a step may be lost in the noise; a choice was not tried at all."""
    study = study_of({"kp": GAIN, "fast": KINDS["fast"]})
    backend = function_backend(study, noisy(lambda **_: 1.0))
    planned, runs, _ = tried(study, backend, whole_range=False)
    assert show_effects(study, planned, runs, whole_range=False)
    out, err = capsys.readouterr()
    assert "warning: kp was not seen to move any metric" in err
    assert "These were small steps; check --sensitivity tries the whole range." in out
    assert "at_start" not in out
    assert "note: not tried: fast" in out


def test_all_runs_fail_at_one_end(function_backend, capsys):
    """That is an effect, and the other end tells of the metrics."""
    study = study_of({"kp": GAIN})

    def function(kp, seed):
        noise = 0.1 * np.random.default_rng(seed).normal()
        return failed("axis: unstable") if kp > 0.9 else {"error": 1.0 + noise, "peak": 1.0}

    planned, runs, found = tried(study, function_backend(study, function))
    assert [(m.effect.metric, m.value) for m in found["kp"].moves] == [(FAILURES, 1.0)]
    assert np.isfinite(found["kp"].effects.effects[0].visible)
    assert show_effects(study, planned, runs, whole_range=True)
    out, err = capsys.readouterr()
    assert "note: kp 1: 2 of 2 runs failed: axis: unstable" in out
    assert err == ""


def test_all_runs_of_both_ends_fail(function_backend, capsys):
    study = study_of({"kp": GAIN})
    backend = function_backend(
        study, lambda kp, seed: failed("no") if kp != 0.5 else {"error": seed, "peak": 1.0}
    )
    planned, runs, found = tried(study, backend)
    assert found["kp"].effects.seen
    assert not found["kp"].effects.conclusive
    assert show_effects(study, planned, runs, whole_range=True)
    assert capsys.readouterr().err == ""


def test_the_default_fails_as_often(function_backend, capsys):
    """Then a failure at one end says nothing."""
    study = study_of({"kp": GAIN})
    asked = iter(range(1000))
    backend = function_backend(
        study, lambda **_: failed("no") if next(asked) > 1 else {"error": 1.0, "peak": 1.0}
    )
    planned, runs, found = tried(study, backend)
    assert not found["kp"].effects.seen
    assert show_effects(study, planned, runs, whole_range=True)
    out, err = capsys.readouterr()
    assert err.startswith("warning: too few runs were completed to tell whether kp moves a metric")
    assert "note: the default: 6 of 8 runs failed: no" in out


def test_nodes_that_are_lost_end_it(function_backend):
    study = study_of({"kp": GAIN})
    asked = iter(range(1000))
    lost = failed("axis does not answer", EvaluationState.LOST)
    backend = function_backend(
        study, lambda **_: lost if next(asked) > 3 else {"error": 1.0, "peak": 1.0}
    )
    with pytest.raises(RunError, match="3 runs in a row were lost with their nodes: axis does"):
        tried(study, backend)
    assert len(backend.calls) == 4 + 3


def test_runs_in_a_screening_design_that_fail(function_backend):
    """Those that are left tell of the metrics, and the failures of the parameter behind them."""
    study = study_of(gains(MOST_SINGLY + 1))

    def function(seed, gain3, gain5, **_):
        rng = np.random.default_rng([seed, 1])
        unstable = gain3 > 0.5
        return failed("no") if unstable else {"error": gain5 + 0.01 * rng.normal(), "peak": 0.0}

    _, _, found = tried(study, function_backend(study, function))
    moves = {n: [m.effect.metric for m in item.moves] for n, item in found.items() if item.moves}
    assert moves == {"gain3": [FAILURES], "gain5": ["error"]}
