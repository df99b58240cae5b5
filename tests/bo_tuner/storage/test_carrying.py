"""What a run takes of one of a similar study: all that is still data, and no more."""

import dataclasses

import numpy as np
import pytest
from earlier_runs import BOUNDARY, GAIN, LOAD, PEAK, machine, record
from functions import NODE
from signal_runs import outcome_of, record_run, signal_study

from bo_tuner.errors import RunRecordError
from bo_tuner.method_names import SAFE
from bo_tuner.methods.registry import METHODS
from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.replay.recompute import measure_again
from bo_tuner.run_notes import Notes, Unusable
from bo_tuner.storage.carrying import carry_over, check_comparable, is_carried, remeasured
from bo_tuner.storage.record import read_run
from bo_tuner.storage.rows import check_study
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import (
    EvaluationState,
    Outcome,
    Stage,
    TrialState,
    count_trials,
)
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning

# A safe search goes in steps from where it is, and not on where no start keeps the limits.
ANYWHERE = [name for name in METHODS if name != SAFE]


def carry(earlier, study):
    """What a run of the study takes; what it does is a record that can be read again."""
    algorithm = METHODS[earlier.algorithm]
    check_comparable(earlier, study, algorithm)
    measure = measure_again(earlier, study) if remeasured(earlier.study, study) else None
    carried = carry_over(earlier, study, algorithm, measure)
    check_study(study, [e for t in carried.trials for e in t.evaluations], carried.trials)
    assert [trial.number for trial in carried.trials] == list(range(len(carried.trials)))
    for trial in carried.trials:
        assert is_carried(trial)
        places = [(e.trial, e.index) for e in trial.evaluations]
        assert places == [(trial.number, k) for k in range(len(places))]
    return carried


@pytest.fixture(scope="module")
def runs(make_study, function_backend, tmp_path_factory):
    """Records of a run by each algorithm."""
    path = tmp_path_factory.mktemp("runs")
    study = make_study().replace(trials=6, initial_trials=4)
    return {name: record(path, study, function_backend, name) for name in METHODS}


class TestRunsCutShort:
    """Bounds are data, whatever limits are now, as long as the metric is measured as it was."""

    def cut(self, runs, algorithm):
        """A record whose second trial ended with a run that was cut short."""
        earlier = runs[algorithm]
        trials = list(earlier.trials)
        *whole, last = trials[1].evaluations
        outcome = Outcome.cut_short(1.5, {"error": 0.4, "peak": 1.2}, "peak at least 1.2")
        evaluations = (*whole, dataclasses.replace(last, outcome=outcome))
        trials[1] = dataclasses.replace(
            trials[1], state=TrialState.CUT_SHORT, evaluations=evaluations, worst_cases={}
        )
        evaluations = tuple(e for trial in trials for e in trial.evaluations)
        return dataclasses.replace(earlier, trials=tuple(trials), evaluations=evaluations)

    def test_their_bounds_are_taken(self, runs, make_study):
        wider = make_study(parameters={"gain": GAIN | {"bounds": [0.0, 2.0]}})
        trial = carry(self.cut(runs, BOUNDARY), wider).trials[1]
        assert trial.state is TrialState.CUT_SHORT
        assert trial.evaluations[-1].outcome.notes.at_least == {"error": 0.4, "peak": 1.2}
        assert all(e.outcome.complete for e in trial.evaluations[:-1])

    def test_not_by_a_method_that_needs_whole_runs(self, runs, make_study):
        carried = carry(self.cut(runs, "V"), make_study())
        assert len(carried.trials) == 5
        assert "cut short" in carried.text


class TestParameters:
    @pytest.mark.parametrize("algorithm", ANYWHERE)
    def test_wider_bounds_keep_all(self, runs, make_study, function_backend, algorithm):
        """And the run goes on from there: the best gain lay outside of the old bounds."""
        earlier = runs[algorithm]
        wider = make_study(parameters={"gain": GAIN | {"bounds": [0.0, 2.0]}})
        study = wider.replace(trials=12, initial_trials=4)
        carried = carry(earlier, study)
        count = len(earlier.evaluations)
        assert carried.text == f"6 of 6 trials and {count} of {count} test runs"
        for trial, before in zip(carried.trials, earlier.trials, strict=True):
            assert trial.parameters == before.parameters
            assert trial.worst_cases == before.worst_cases
            metrics, expected = (
                [e.outcome.metrics for e in t.evaluations] for t in (trial, before)
            )
            assert metrics == expected
            # Lengths in another cube.
            assert not trial.hyperparameters
        found = list(
            Tuning(
                study,
                Driver(function_backend(study, machine)),
                METHODS[algorithm],
                trials=carried.trials,
            )
        )
        assert len(found) == 6
        if algorithm != "II":
            assert max(trial.parameters["gain"] for trial in found) > 1.0

    def test_of_the_same_study_nothing_is_lost(self, runs, make_study):
        earlier = runs[BOUNDARY]
        carried = carry(earlier, earlier.study.replace(trials=60, seed=9))
        hyperparameters = [trial.hyperparameters for trial in earlier.trials]
        assert [trial.hyperparameters for trial in carried.trials] == hyperparameters

    @pytest.mark.parametrize("algorithm", ANYWHERE)
    def test_narrower_bounds_leave_out_what_is_outside(
        self, runs, make_study, function_backend, algorithm
    ):
        earlier = runs[algorithm]
        study = make_study(parameters={"gain": GAIN | {"bounds": [0.4, 0.9]}}).replace(trials=9)
        inside = [t for t in earlier.trials if 0.4 <= t.parameters["gain"] <= 0.9]
        assert 0 < len(inside) < 6
        carried = carry(earlier, study)
        assert [t.parameters for t in carried.trials] == [t.parameters for t in inside]
        origins = [f"(from {carried.run}, trial {trial.number})" for trial in inside]
        assert [t.origin.partition(" ")[2] for t in carried.trials] == origins
        outside = 6 - len(inside)
        plural = "s" if outside > 1 else ""
        assert f"left out: {outside} trial{plural} outside the bounds of gain" in carried.text
        backend = function_backend(study, machine)
        found = list(Tuning(study, Driver(backend), METHODS[algorithm], trials=carried.trials))
        assert len(found) == 9 - len(inside)
        assert all(0.4 <= trial.parameters["gain"] <= 0.9 for trial in found)

    @pytest.mark.parametrize(
        ("then", "values", "now", "reason"),
        [
            (
                GAIN,
                [0.5, 0.7],
                NODE | {"type": "double", "fixed": 0.7},
                "1 trial with another value",
            ),
            (NODE | {"type": "double", "fixed": 0.5}, [0.5], GAIN, ""),
            (GAIN, [0.5, 0.61], GAIN | {"step": 0.25}, "1 trial off the step of gain"),
            (GAIN, [0.5, 0.61], GAIN | {"scale": "log", "bounds": [0.1, 9.0]}, ""),
            (
                NODE | {"type": "string", "choices": ["a", "b", "c"], "default": "a"},
                ["a", "b"],
                NODE | {"type": "string", "choices": ["a", "c"], "default": "a"},
                "1 trial outside the choices of gain",
            ),
        ],
    )
    def test_what_a_parameter_may_be(
        self, tmp_path, make_study, make_trial, then, values, now, reason
    ):
        other = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
        earlier_study = make_study(parameters={"gain": then, "other": other})
        trials = [
            make_trial(k, {"gain": value, "other": 0.1}, [1.0]) for k, value in enumerate(values)
        ]
        earlier = record(tmp_path, earlier_study, None, trials=trials)
        carried = carry(earlier, make_study(parameters={"gain": now, "other": other}))
        assert reason in carried.text
        assert ("left out" in carried.text) is bool(reason)
        assert len(carried.trials) == len(values) - bool(reason)

    def test_an_order(self, tmp_path, make_study, make_trial):
        both = {"gain": GAIN, "other": GAIN}
        trials = [make_trial(k, {"gain": g, "other": 0.6}, [1.0]) for k, g in enumerate([0.5, 0.7])]
        earlier = record(tmp_path, make_study(parameters=both), None, trials=trials)
        carried = carry(earlier, make_study(parameters=both, order=[["gain", "other"]]))
        assert [trial.parameters["gain"] for trial in carried.trials] == [0.5]
        assert "1 trial against the order of the parameters" in carried.text

    def test_none_is_left(self, runs, make_study):
        study = make_study(parameters={"gain": GAIN | {"bounds": [2.0, 3.0], "default": 2.5}})
        with pytest.raises(RunRecordError, match="none of its 6 trials can be used: 6 trials outs"):
            carry(runs[BOUNDARY], study)

    @pytest.mark.parametrize(
        ("sections", "named"),
        [
            (
                {"parameters": {"gain": GAIN, "kd": GAIN}},
                "parameters.kd.node nothing -> text 'axis'",
            ),
            ({"parameters": {"gain": GAIN | {"parameter": "kp"}}}, "parameters.gain.parameter"),
            ({"contexts": {}}, "contexts.load.node text 'axis' -> nothing"),
            ({"trigger": NODE | {"service": "~/run", "timeout": 9.0}}, "trigger.timeout"),
        ],
    )
    def test_another_system(self, runs, make_study, sections, named):
        with pytest.raises(RunRecordError, match="is a run of another study: ") as refusal:
            carry(runs[BOUNDARY], make_study(**sections))
        assert named in str(refusal.value)


class TestLimits:
    @pytest.mark.parametrize("algorithm", ANYWHERE)
    def test_another_limit_on_the_same_metric(self, runs, make_study, function_backend, algorithm):
        earlier = runs[algorithm]
        study = make_study(constraints={"top": PEAK | {"upper": 0.4}}).replace(trials=7)
        carried = carry(earlier, study)
        expected = [trial.worst_cases["peak"] for trial in earlier.trials]
        assert [trial.worst_cases["top"] for trial in carried.trials] == expected
        backend = function_backend(study, machine)
        (trial,) = Tuning(study, Driver(backend), METHODS[algorithm], trials=carried.trials)
        assert trial.worst_cases.keys() == {"top"}

    @pytest.mark.parametrize("algorithm", ["I", "V", BOUNDARY])
    def test_a_new_worst_case_is_that_of_the_evaluations(self, runs, make_study, algorithm):
        """That of 0.1 load, at a gain that is given, is at the largest load."""
        earlier = runs[algorithm]
        study = make_study(constraints={"off": PEAK | {"metric": "error"}})
        for trial in carry(earlier, study).trials:
            gain, worst = trial.parameters["gain"], trial.worst_cases["off"]
            load = 1.5 if algorithm == "I" else 2.0
            assert worst.context["load"] == pytest.approx(load, abs=0.2)
            assert worst.value == pytest.approx((gain - 1.5) ** 2 + 0.1 * load, abs=0.05)

    @pytest.mark.parametrize("algorithm", ["II", "III", "IV"])
    def test_one_that_no_trial_has_searched_for(self, runs, make_study, algorithm):
        study = make_study(constraints={"off": PEAK | {"metric": "error"}})
        with pytest.raises(RunRecordError, match=r"constraints.off was not searched for"):
            carry(runs[algorithm], study)

    @pytest.mark.parametrize("algorithm", METHODS)
    def test_another_objective_and_a_share_of_runs(
        self, runs, make_study, function_backend, algorithm
    ):
        chance = {"kind": "chance", "metric": "error", "upper": 2.0, "probability": 0.8}
        study = make_study(
            objective={"metric": "peak", "direction": "maximize"},
            constraints={"peak": PEAK, "error": chance},
        ).replace(trials=7)
        carried = carry(runs[algorithm], study)
        assert len(carried.trials) == 6
        backend = function_backend(study, machine)
        (trial,) = Tuning(study, Driver(backend), METHODS[algorithm], trials=carried.trials)
        assert trial.state is TrialState.COMPLETE

    def test_a_logarithm_that_an_evaluation_does_not_have(self, tmp_path, make_study, make_trial):
        trials = [make_trial(k, {"gain": 0.5 + 0.1 * k}, [e]) for k, e in enumerate([1.0, 0.0])]
        earlier = record(tmp_path, make_study(), None, trials=trials)
        study = make_study(objective={"metric": "error", "scale": "log"})
        first, second = carry(earlier, study).trials
        assert first.state is TrialState.COMPLETE
        assert second.reason == "metric error is 0.0; its log scale needs a positive value"

    def test_a_scale_changes_what_models_make_of_it_and_not_what_is_measured(
        self, tmp_path, make_study, make_trial
    ):
        trials = [make_trial(k, {"gain": 0.5 + 0.1 * k}, [1.0]) for k in range(2)]
        earlier = record(tmp_path, make_study(), None, trials=trials)
        node = {"node": "axis"}
        study = make_study(metrics={"error": node, "peak": node | {"scale": "log"}})
        carried = carry(earlier, study)
        assert [t.state for t in carried.trials] == [TrialState.COMPLETE] * 2


class TestContexts:
    def test_what_is_still_possible_is_data_but_no_draw(self, runs, make_study, function_backend):
        earlier = runs[BOUNDARY]
        study = make_study(contexts={"load": LOAD | {"bounds": [1.2, 3.0]}}).replace(trials=8)
        inside = [e for e in earlier.evaluations if e.context["load"] >= 1.2]
        assert len(inside) < len(earlier.evaluations)
        carried = carry(earlier, study)
        taken = [e for trial in carried.trials for e in trial.evaluations]
        assert [e.context for e in taken] == [e.context for e in inside]
        assert {e.stage for e in taken} == {Stage.SEARCH}
        assert all(trial.mean("error") is None for trial in carried.trials)
        # The largest load is another one.
        for trial in carried.trials:
            assert trial.worst_cases["peak"].context["load"] > 2.0
        assert f"{len(inside)} of {len(earlier.evaluations)} test runs; left out:" in carried.text
        assert "outside the distribution of load" in carried.text
        backend = function_backend(study, machine)
        found = list(Tuning(study, Driver(backend), METHODS[BOUNDARY], trials=carried.trials))
        assert count_trials([*carried.trials, *found]) == 8

    def test_values_that_are_none(self, runs, make_study):
        """Of a distribution with values, no other one is possible."""
        other = {"distribution": "discrete", "values": [1.0, 2.0], "probabilities": [0.5, 0.5]}
        carried = carry(runs[BOUNDARY], make_study(contexts={"load": NODE | other}))
        loads = {e.context["load"] for trial in carried.trials for e in trial.evaluations}
        assert loads <= {1.0, 2.0}

    @pytest.mark.parametrize("algorithm", ["II", "III", "IV", "V"])
    def test_means_over_draws_are_those_of_a_distribution(self, runs, make_study, algorithm):
        study = make_study(contexts={"load": LOAD | {"bounds": [1.0, 2.5]}})
        with pytest.raises(RunRecordError, match=r"contexts.load has another distribution"):
            carry(runs[algorithm], study)

    def test_the_nominal_context_alone(self, runs, make_study):
        study = make_study(contexts={"load": LOAD | {"bounds": [0.0, 9.0], "nominal": 1.5}})
        carried = carry(runs["I"], study)
        assert [t.evaluations[0].stage for t in carried.trials] == [Stage.NOMINAL] * 6
        moved = make_study(contexts={"load": LOAD | {"bounds": [0.0, 9.0]}})
        with pytest.raises(RunRecordError, match=r"contexts.load .* runs the nominal context"):
            carry(runs["I"], moved)


class TestOutcomes:
    def test_what_was_lost_or_disturbed_is_left_out(self, tmp_path, make_study, make_trial):
        def ending(number, state, **notes):
            trial = make_trial(number, {"gain": 0.1 * number})
            outcome = Outcome(state, reason="gone", notes=Notes(**notes))
            evaluations = (dataclasses.replace(trial.evaluations[0], outcome=outcome),)
            return dataclasses.replace(trial, evaluations=evaluations)

        trials = [
            ending(0, EvaluationState.LOST),
            ending(1, EvaluationState.FAILED, unusable=Unusable.DISTURBED),
            ending(2, EvaluationState.FAILED),
            make_trial(3, {"gain": 0.5}, [1.0]),
        ]
        carried = carry(record(tmp_path, make_study(), None, trials=trials), make_study())
        assert [trial.parameters["gain"] for trial in carried.trials] == [0.2, 0.5]
        assert "left out: 1 trial lost; 1 trial disturbed" in carried.text

    def test_a_metric_less(self, runs, make_study):
        study = make_study(metrics={"error": NODE}, constraints={})
        for trial in carry(runs[BOUNDARY], study).trials:
            assert all(e.outcome.metrics.keys() == {"error"} for e in trial.evaluations)

    def test_a_metric_that_the_node_has_reported_all_along(self, runs, make_study):
        study = make_study(
            metrics={"error": NODE, "peak": NODE, "work": NODE | {"key": "effort"}},
            objective={"metric": "work"},
        )
        carried = carry(runs[BOUNDARY], study)
        assert len(carried.trials) == 6
        for trial in carried.trials:
            for evaluation in trial.evaluations:
                assert evaluation.outcome.metrics["work"] == 3.0 * trial.parameters["gain"]

    def test_one_that_it_has_not(self, runs, make_study):
        study = make_study(metrics={"error": NODE, "peak": NODE, "heat": NODE})
        with pytest.raises(RunRecordError, match="6 trials without a record of heat"):
            carry(runs[BOUNDARY], study)

    def test_failures(self, tmp_path, make_study, make_trial):
        """One stays one, unless it lay in how the run was measured."""
        trials = [make_trial(0, {"gain": 0.5}, [1.0]), make_trial(1, {"gain": 0.6})]
        unmeasured = make_trial(2, {"gain": 0.7})
        outcome = Outcome(EvaluationState.FAILED, {}, "axis: metric peak is nan")
        evaluations = (dataclasses.replace(unmeasured.evaluations[0], outcome=outcome),)
        trials.append(dataclasses.replace(unmeasured, evaluations=evaluations))
        earlier = record(tmp_path, make_study(), None, trials=trials)
        study = make_study(metrics={"error": NODE}, constraints={})
        carried = carry(earlier, study)
        assert [trial.reason for trial in carried.trials] == ["", "axis: stalled"]
        assert "1 trial failed by what is measured otherwise now" in carried.text
        same = carry(earlier, make_study(constraints={"peak": PEAK | {"upper": 3.0}}))
        assert len(same.trials) == 3


class TestRelativeToTheDefault:
    """What the default has is on record, with its value in each draw of the earlier run."""

    @staticmethod
    def limited(make_study, upper, **sections):
        limit = {"kind": "chance", "metric": "peak", "upper": upper, "probability": 0.9}
        return make_study(constraints={"calm": limit}, **sections)

    @pytest.fixture
    def earlier(self, tmp_path, make_study, function_backend):
        return record(tmp_path, self.limited(make_study, "1.1 * default"), function_backend)

    @pytest.mark.parametrize("factor", [1.1, 1.25])
    def test_each_multiple_of_it_is_known(self, earlier, make_study, factor):
        carried = carry(earlier, self.limited(make_study, f"{factor} * default + 1"))
        assert len(carried.trials) == len(earlier.trials)
        assert "left out" not in carried.text
        for evaluation in (e for trial in carried.trials for e in trial.evaluations):
            # By the definition of the machine, whose default has a gain of 0.5.
            peak, default = (0.5 * g * evaluation.context["load"] for g in (
                evaluation.parameters["gain"], 0.5,
            ))  # fmt: skip
            found = evaluation.outcome.metrics[f"peak_minus_{factor}_default"]
            assert found == pytest.approx(peak - factor * default)

    def test_another_default_is_not_known(self, earlier, make_study):
        study = self.limited(
            make_study, "1.1 * default", parameters={"gain": GAIN | {"default": 0.4}}
        )
        with pytest.raises(RunRecordError, match=r"record of peak_minus_1\.1_default"):
            carry(earlier, study)

    def test_a_run_without_such_a_limit_has_no_record_of_it(self, runs, make_study):
        study = self.limited(make_study, "1.1 * default")
        with pytest.raises(RunRecordError, match=r"record of peak_minus_1\.1_default"):
            carry(runs[BOUNDARY], study)

    def test_of_a_metric_that_the_earlier_run_has_not_compared(self, earlier, make_study):
        limit = {"kind": "chance", "metric": "error", "upper": "default", "probability": 0.9}
        with pytest.raises(RunRecordError, match="without a record of error_minus_default"):
            carry(earlier, make_study(constraints={"good": limit}))


class TestSignals:
    """Metrics of another definition are computed from the bags."""

    def recording(self, level):
        times = np.linspace(0.0, 2.0, 21)
        return Recording(
            {
                "setpoint": RecordedSignal(np.array([-0.1, 1.0]), np.ones(2)),
                "angle": RecordedSignal(times, np.full(21, level)),
            },
            2.0,
        )

    @pytest.fixture
    def folder(self, tmp_path):
        study = study_from_mapping(signal_study())
        recordings = {0.5: [self.recording(0.2)], 0.7: [self.recording(0.4)]}
        return record_run(tmp_path / "run", study, recordings)

    def test_from_bags(self, folder):
        metrics = {
            "error": {"of": "setpoint - angle", "measure": "ise"},
            "largest": {"of": "angle", "measure": "maximum"},
        }
        study = study_from_mapping(signal_study(metrics=metrics))
        carried = carry(read_run(folder), study)
        found = [trial.evaluations[0].outcome.metrics for trial in carried.trials]
        # Integrals over 2 s of the square of a constant.
        assert [item["error"] for item in found] == pytest.approx([2.0 * 0.64, 2.0 * 0.36])
        assert [item["largest"] for item in found] == [0.2, 0.4]

    def test_trials_without_a_bag(self, folder):
        bag = folder / "bags" / "trial_0000"
        bag.rename(folder / "elsewhere")
        study = study_from_mapping(
            signal_study(metrics={"error": {"of": "setpoint - angle", "measure": "ise"}})
        )
        carried = carry(read_run(folder), study)
        assert [trial.parameters["gain"] for trial in carried.trials] == [0.7]
        assert "1 trial without a record of error" in carried.text

    def test_bags_are_not_asked_where_nothing_else_is_measured(self, folder):
        (folder / "bags").rename(folder / "elsewhere")
        before = read_run(folder)
        # Another unit is only another name, and a further signal is none of the metric's.
        metrics = {"error": {"of": "setpoint - angle", "measure": "iae", "unit": "rad s"}}
        signals = signal_study()["signals"] | {"current": {"topic": "/current", "field": "data"}}
        study = study_from_mapping(signal_study(metrics=metrics, signals=signals))
        carried = carry(before, study)
        expected = [outcome_of(before.study, self.recording(level)) for level in (0.2, 0.4)]
        found = [trial.evaluations[0].outcome.metrics for trial in carried.trials]
        assert found == [outcome.metrics for outcome in expected]

    @pytest.mark.parametrize("change", [{"field": "other"}, {"time": "header"}])
    def test_other_signals(self, folder, change):
        signals = signal_study()["signals"]
        signals = signals | {"angle": signals["angle"] | change}
        with pytest.raises(RunRecordError, match="has no recording of signal angle"):
            carry(read_run(folder), study_from_mapping(signal_study(signals=signals)))
