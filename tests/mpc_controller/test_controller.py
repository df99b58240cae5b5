"""One controller: steps, cuts, fallbacks and what it reports of them."""

import itertools
import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feed_axis_common.errors import SettingsError
from feed_axis_common.model import delay_augmented, feed_axis
from mpc_controller import controller as controller_module
from mpc_controller import mpc as mpc_module
from mpc_controller.controller import HOLD_LAST_INPUT, MpcController
from mpc_controller.errors import ControllerError
from mpc_controller.kalman_filter import kalman_filter
from mpc_controller.mpc import Solution

REFERENCE = np.repeat([0.5, 0.8, 0.6], 15)


def measurements(seed=0):
    return 0.6 + np.random.default_rng(seed).normal(0.0, 0.1, REFERENCE.size)


def run(controller, values, reference=REFERENCE):
    controller.start(reference)
    return [controller.step(float(y)) for y in values]


def commands(steps):
    return [step.command for step in steps]


def test_a_cut_at_rest_stays_at_rest():
    steps = run(MpcController(), [0.5] * 20, np.full(20, 0.5))
    np.testing.assert_allclose(commands(steps), 0.5, atol=1e-4)
    np.testing.assert_allclose([step.estimate for step in steps], 0.5, atol=1e-4)
    assert {step.status for step in steps} == {"solved"}


def test_equal_measurements_give_equal_commands_bit_for_bit():
    first, second = MpcController(), MpcController()
    expected = commands(run(first, measurements()))
    assert commands(run(second, measurements())) == expected
    # A cut leaves nothing behind for the next one.
    run(first, measurements(1)[:20])
    assert commands(run(first, measurements())) == expected


@pytest.mark.parametrize("gain", [0.5, 2.0])
def test_the_static_gain_of_the_axis_is_taken_into_account(controller_settings, gain):
    settings = controller_settings(gain=gain, input_upper=5.0)
    steps = run(MpcController(settings), [0.5] * 20, np.full(20, 0.5))
    np.testing.assert_allclose(commands(steps), 0.5 / gain, atol=1e-3)


def test_preview_past_the_end_holds_the_last_value():
    whole = np.concatenate((REFERENCE, np.full(30, REFERENCE[-1])))
    short = run(MpcController(), measurements())
    long = run(MpcController(), measurements(), whole)
    assert commands(short) == commands(long)


def test_the_first_sample_of_the_preview_is_the_next_one(controller_settings):
    """With a horizon of the next output alone, a step shows in the command one sample ahead."""
    settings = controller_settings(
        control_horizon=1, prediction_horizon=1, dead_time=0.0, lambda_kf=-12.0
    )
    reference = np.repeat([0.5, 0.7], 10)
    u = commands(run(MpcController(settings), [0.5] * 10, reference))
    np.testing.assert_allclose(u[:9], 0.5, atol=1e-4)
    assert u[9] > 0.6


@given(
    moves=st.integers(1, 8),
    extra=st.integers(0, 8),
    lambda_mpc=st.floats(-8.0, 8.0),
    lambda_kf=st.floats(-12.0, 8.0),
    dead_time=st.floats(0.0, 0.08),
    lower=st.floats(-1.0, 0.4),
    estimate_disturbance=st.booleans(),
    lambda_disturbance=st.floats(-12.0, 4.0),
    values=st.lists(st.floats(-1e100, 1e100) | st.sampled_from([math.nan, math.inf, -math.inf])),
)
def test_input_limits_hold_for_any_settings_and_measurements(
    controller_settings,
    moves,
    extra,
    lambda_mpc,
    lambda_kf,
    dead_time,
    lower,
    estimate_disturbance,
    lambda_disturbance,
    values,
):
    settings = controller_settings(
        control_horizon=moves,
        prediction_horizon=moves + extra,
        lambda_mpc=lambda_mpc,
        lambda_kf=lambda_kf,
        dead_time=dead_time,
        input_lower=lower,
        estimate_disturbance=estimate_disturbance,
        lambda_disturbance=lambda_disturbance,
    )
    controller = MpcController(settings)
    for step in run(controller, values[: REFERENCE.size]):
        assert lower <= step.command <= settings.input_upper
        assert step.return_time > 0.0


def test_a_start_beyond_the_limits_begins_with_the_nearest_input(controller_settings, monkeypatch):
    monkeypatch.setitem(mpc_module.SOLVER_SETTINGS, "max_iter", 1)
    controller = MpcController(controller_settings(input_upper=0.4))
    assert run(controller, [0.5])[0].command == 0.4


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_measurement_that_is_not_finite_is_left_out_and_counted(bad):
    """The estimate is then the prediction: that of a measurement that agrees with it."""
    controller = MpcController()
    values = measurements()
    steps = run(controller, [*values[:5], bad, *values[6:]])
    assert all(math.isfinite(u) for u in commands(steps))
    result = controller.cut_result()
    assert result["status"] == "failed"
    assert result["reason"] == f"sample 5: measurement is {bad}"
    assert result["fallbacks"] == 1
    # The command of that sample is the same whichever bad value it was.
    assert steps[5].command == run(MpcController(), [*values[:5], math.nan])[5].command


def test_a_lost_measurement_gives_no_command(monkeypatch):
    """The filter goes on with the last one that was sent, and the next move starts from it."""
    controller = MpcController()
    controller.start([0.2, 0.2, *[0.8] * 8])
    controller.step(0.2)
    sent = controller.step(0.2).command
    known, predict = [], type(controller._kf).predict

    def note(filter_, command):
        known.append(command)
        predict(filter_, command)

    monkeypatch.setattr(type(controller._kf), "predict", note)
    solved = []
    solve = controller._mpc.solve
    monkeypatch.setattr(
        controller._mpc, "solve", lambda x, last, r: solved.append(last) or solve(x, last, r)
    )
    for _ in range(3):
        controller.skip()
    assert known == [sent] * 3
    controller.step(0.3)
    assert solved == [sent]
    assert controller.samples_done == 6
    result = controller.cut_result()
    assert (result["fallbacks"], result["reason"]) == (3, "sample 2: the measurement was lost")
    assert result["samples"] == 6


def test_a_solver_without_an_answer_holds_the_last_input_and_is_named(monkeypatch):
    monkeypatch.setitem(mpc_module.SOLVER_SETTINGS, "max_iter", 1)
    controller = MpcController()
    steps = run(controller, measurements())
    assert set(commands(steps)) == {0.5}
    assert all("max" in step.status for step in steps)
    result = controller.cut_result()
    assert result["status"] == "failed"
    assert result["fallbacks"] == REFERENCE.size
    assert HOLD_LAST_INPUT == "hold_last_input"
    assert result["reason"] == f"sample 0: solver status {steps[0].status}; hold_last_input"


def test_a_single_failure_of_the_solver_holds_one_sample(monkeypatch):
    solve = mpc_module.Mpc.solve
    calls = itertools.count()

    def fail_once(self, *arguments):
        solution = solve(self, *arguments)
        return Solution(None, "broken", 7) if next(calls) == 4 else solution

    monkeypatch.setattr(controller_module.Mpc, "solve", fail_once)
    controller = MpcController()
    steps = run(controller, measurements())
    assert steps[4].command == steps[3].command
    assert steps[4].status == "broken"
    assert {step.status for step in steps[5:]} == {"solved"}
    result = controller.cut_result()
    assert result["fallbacks"] == 1
    assert result["reason"] == "sample 4: solver status broken; hold_last_input"


def test_the_filter_goes_on_with_the_commands_that_were_given(controller_settings, monkeypatch):
    """Also with the one that was held for want of a solution."""
    solve = mpc_module.Mpc.solve
    calls = itertools.count()

    def fail_at_times(self, *arguments):
        solution = solve(self, *arguments)
        return Solution(None, "broken", 7) if next(calls) % 5 == 4 else solution

    monkeypatch.setattr(controller_module.Mpc, "solve", fail_at_times)
    values = measurements()
    steps = run(MpcController(), values)
    s = controller_settings()
    model = delay_augmented(
        *feed_axis(s.gain, s.damping_ratio, s.natural_frequency), s.sample_time, s.dead_time
    )
    kf = kalman_filter(model, s.measurement_variance, s.lambda_kf, model.equilibrium(0.5, s.gain))
    for step, y in zip(steps, values, strict=True):
        kf.update(y)
        assert step.estimate == pytest.approx(kf.x[0, 0], abs=1e-12)
        kf.predict(step.command)


def test_a_cut_without_faults_is_ok():
    controller = MpcController()
    run(controller, measurements())
    result = controller.cut_result()
    assert (result["status"], result["reason"], result["fallbacks"]) == ("ok", "", 0)
    assert result["samples"] == REFERENCE.size
    assert result["mean_iterations"] > 0


@pytest.mark.parametrize("reference", [[], [0.5, math.nan], [math.inf], [[0.5, 0.5]], 0.5])
def test_an_unusable_reference_is_refused_and_ends_the_cut_before(reference):
    controller = MpcController()
    run(controller, measurements()[:3])
    with pytest.raises(ControllerError, match=r"^reference: "):
        controller.start(reference)
    assert controller.reference_length == 0
    with pytest.raises(ControllerError, match="no cut is running"):
        controller.step(0.5)


def test_steps_need_a_running_cut():
    controller = MpcController()
    assert controller.reference_length == 0
    assert controller.samples_done == 0
    with pytest.raises(ControllerError, match="no cut is running"):
        controller.step(0.5)
    run(controller, measurements())
    assert controller.samples_done == REFERENCE.size
    with pytest.raises(ControllerError, match="no cut is running"):
        controller.step(0.5)


def test_parameters_change_all_or_none():
    controller = MpcController()
    before = controller.settings
    with pytest.raises(SettingsError, match="prediction_horizon: 3 is below control_horizon 15"):
        controller.set_parameters({"lambda_mpc": -2.0, "prediction_horizon": 3})
    with pytest.raises(SettingsError, match="lambda: unknown parameter"):
        controller.set_parameters({"lambda_mpc": -2.0, "lambda": 1.0})
    assert controller.settings is before
    controller.set_parameters({"lambda_mpc": -2, "control_horizon": 3})
    assert controller.settings.lambda_mpc == -2.0
    assert controller.settings.control_horizon == 3


def test_a_change_takes_effect_at_the_next_cut():
    values = measurements()
    controller = MpcController()
    controller.start(REFERENCE)
    steps = []
    for k, y in enumerate(values):
        if k == 10:
            controller.set_parameters({"lambda_mpc": 0.0, "input_upper": 0.55})
        steps.append(controller.step(float(y)))
    unchanged = MpcController()
    assert commands(steps) == commands(run(unchanged, values))
    assert controller.cut_result()["lambda_mpc"] == -3.0
    changed = run(controller, values)
    assert max(commands(changed)) <= 0.55
    assert controller.cut_result()["lambda_mpc"] == 0.0


def test_the_result_names_the_parameters_of_the_cut(controller_settings):
    controller = MpcController(
        controller_settings(control_horizon=2, prediction_horizon=4, lambda_mpc=-3.9, lambda_kf=2.0)
    )
    run(controller, measurements())
    result = controller.cut_result()
    assert result["control_horizon"] == 2
    assert result["prediction_horizon"] == 4
    assert result["lambda_mpc"] == -3.9
    assert result["lambda_kf"] == 2.0


def test_measured_return_times_are_summed_up_by_quantiles():
    controller = MpcController()
    times = [step.return_time for step in run(controller, measurements())]
    result = controller.cut_result()
    assert result["return_time_source"] == "measured"
    assert result["return_time_max"] == max(times)
    for name, share in (("p50", 0.5), ("p96", 0.96), ("p99", 0.99)):
        expected = np.quantile(times, share, method="inverted_cdf")
        assert result[f"return_time_{name}"] == expected


def test_computing_time_has_no_waiting_in_it(controller_settings, monkeypatch):
    """A step that waits for 50 ms in its middle: of that nothing is computed."""
    wait = 0.05

    def solve(mpc, *arguments):
        time.sleep(wait)
        return Solution(0.5, "solved", 1)

    monkeypatch.setattr(mpc_module.Mpc, "solve", solve)
    p50 = {}
    for source in ("measured", "cpu"):
        controller = MpcController(controller_settings(return_time=source))
        run(controller, measurements()[:5])
        result = controller.cut_result()
        assert result["return_time_source"] == source
        p50[source] = result["return_time_p50"]
    assert 0.0 < p50["cpu"] < wait <= p50["measured"]


def test_computing_time_counts_what_the_solver_does(controller_settings, monkeypatch):
    """OSQP solves in the thread that calls it."""
    plain = mpc_module.Mpc.solve
    solving = []

    def solve(mpc, *arguments):
        begin = time.thread_time()
        solution = plain(mpc, *arguments)
        solving.append(time.thread_time() - begin)
        return solution

    monkeypatch.setattr(mpc_module.Mpc, "solve", solve)
    controller = MpcController(controller_settings(return_time="cpu"))
    steps = run(controller, measurements())
    assert all(
        0.0 < inside <= step.return_time for inside, step in zip(solving, steps, strict=True)
    )


def test_modelled_return_times_are_the_same_every_time_and_grow_with_the_horizon(
    controller_settings,
):
    p99 = []
    for horizon in (1, 3, 6, 10, 15, 20):
        records = []
        for _ in range(2):
            controller = MpcController(
                controller_settings(
                    return_time="modelled", control_horizon=horizon, prediction_horizon=horizon + 5
                )
            )
            records.append([step.return_time for step in run(controller, measurements())])
        assert records[0] == records[1]
        p99.append(controller.cut_result()["return_time_p99"])
    assert controller.cut_result()["return_time_source"] == "modelled"
    assert p99 == sorted(set(p99))


def test_modelled_return_time_scales_with_its_constants(controller_settings):
    def times(**constants):
        settings = controller_settings(return_time="modelled", **constants)
        return np.array([step.return_time for step in run(MpcController(settings), measurements())])

    base = times(modelled_overhead=0.0, modelled_operation_time=1e-9)
    both = times(modelled_overhead=2e-4, modelled_operation_time=3e-9)
    np.testing.assert_allclose(both, 2e-4 + 3 * base, rtol=1e-12)


def test_the_callers_reference_may_change_after_the_start():
    reference = REFERENCE.copy()
    controller = MpcController()
    controller.start(reference)
    reference[:] = 0.0
    u = [controller.step(float(y)).command for y in measurements()]
    assert u == commands(run(MpcController(), measurements()))
