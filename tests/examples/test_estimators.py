"""Estimators that hear bags: each node gives what its filter does by itself."""

import dataclasses

import commands
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest

from bo_tuner.package_files import config_directory
from bo_tuner.trials import Evaluation, EvaluationState, Stage

EXAMPLE = "estimators"
SECONDS = 6.0
GAINS = {"gain": 0.7, "bias_gain": 0.05, "trust": 0.5}


@pytest.fixture
def attitude(module_of):
    return module_of(EXAMPLE, "attitude")


def metrics(backend, parameters, context):
    outcome = backend.outcome(Evaluation(0, 0, Stage.DRAWN, parameters, context, 1))
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    return outcome.metrics


class TestAttitude:
    def test_rotations_are_those_of_scipy(self, attitude):
        angles = np.array([0.3, -0.2, 1.1])
        w, x, y, z = attitude.rotation_of(*angles)
        assert Rotation.from_euler("xyz", angles).as_quat() == pytest.approx([x, y, z, w])
        assert attitude.roll_pitch((w, x, y, z)) == pytest.approx(angles[:2])
        vector = (1.0, 2.0, 3.0)
        seen = Rotation.from_quat([x, y, z, w]).inv().apply(vector)
        assert attitude.in_body((w, x, y, z), vector) == pytest.approx(seen)

    def test_without_noise_the_rates_lead_from_one_rotation_to_the_next(self, attitude):
        made = attitude.flight(1, SECONDS).truth
        rate = attitude.rate_between(*made[:2])
        assert attitude.turned(made[0], rate, 1.0 / attitude.RATE) == pytest.approx(made[1])

    def test_the_filter_finds_the_rotation_and_the_bias(self, attitude):
        """At rest; about the direction of gravity no bias can be seen."""
        filter_ = attitude.Filter(2.0, 0.5, 5.0)
        truth, bias = attitude.rotation_of(0.2, -0.1, 0.0), (0.02, -0.03, 0.0)
        felt = attitude.in_body(truth, (0.0, 0.0, attitude.GRAVITY))
        for k in range(3000):
            filter_.take(0.02 * k, bias, felt)
        assert attitude.roll_pitch(filter_.rotation) == pytest.approx((0.2, -0.1), abs=1e-4)
        unseen = np.subtract(filter_.bias, bias)
        assert np.cross(unseen, felt) == pytest.approx(np.zeros(3), abs=1e-4)

    @pytest.mark.ros
    def test_the_node_gives_what_its_filter_does_by_itself(
        self, attitude, module_of, backend_of, tmp_path
    ):
        write = module_of(EXAMPLE, "make_drives").write_flight
        bags = [tmp_path / f"flight_{seed}" for seed in (1, 2)]
        for seed, bag in enumerate(bags, start=1):
            write(bag, seed, SECONDS)
        worst = '  worst: {of: "hypot(true_roll - roll, true_pitch - pitch)", measure: maximum}\n'
        backend = backend_of(
            EXAMPLE,
            ('["flights/*"]', f"[{bags[0]}, {bags[1]}]"),
            ("\nobjective:", f"{worst}\nobjective:"),
            study="attitude.yaml",
        )
        for seed in (2, 1):
            made, filter_ = attitude.flight(seed, SECONDS), attitude.Filter(**GAINS)
            errors = []
            for time, rate, felt in made.measured:
                found = attitude.roll_pitch(filter_.take(time, rate, felt))
                true = attitude.roll_pitch(made.truth[round(time * attitude.RATE)])
                errors.append(np.hypot(*np.subtract(found, true)))
            played = metrics(backend, GAINS, {"flight": str(bags[seed - 1])})
            assert played["worst"] == pytest.approx(max(errors), rel=1e-6)


@pytest.mark.ros
@pytest.mark.slow
def test_the_filter_of_the_axis_gives_what_the_controller_has_estimated(
    module_of, backend_of, tmp_path
):
    """Bags of trials have the controller's own estimates, of the same measurements and commands."""
    text = (config_directory() / "studies/benchmark.yaml").read_text()
    for old, new in (
        ("trials: 30", "trials: 2"),
        ("initial_trials: 10", "initial_trials: 2"),
        ("drawn_contexts: 5", "drawn_contexts: 1"),
        ("search_evaluations: 10", "search_evaluations: 1"),
        ("validation_draws: 25", "validation_draws: 1"),
    ):
        text = text.replace(old, new)
    (tmp_path / "tuned.yaml").write_text(text)
    code, _, err = commands.run(
        *("tune", "--study", "tuned.yaml", "--record", "all", "--quiet"), folder=tmp_path
    )
    assert code == 0, err
    bags = [tmp_path / f"runs/latest/bags/trial_000{number}" for number in (0, 1)]
    axis, optimum = (module_of(EXAMPLE, name) for name in ("axis", "optimum"))
    own = dataclasses.asdict(axis.default_settings())
    parameters = {"lambda_kf": -1.0, "measurement_variance": own["measurement_variance"]}
    with AnyReader([bags[0]], default_typestore=optimum.TYPES) as reader:
        known = [c for c in reader.connections if c.topic == "/mpc_controller/estimated_state"]
        estimated = [
            float(reader.deserialize(data, connection.msgtype).velocity[0])
            for connection, _, data in reader.messages(known)
        ]
    filter_, heard = axis.Filter(*parameters.values()), list(optimum.messages(bags[0]))
    found = [result[0] for message in heard if (result := filter_.take(*message))]
    assert found == estimated
    named = f"[{bags[0]}, {bags[1]}]"
    backend = backend_of(EXAMPLE, ('["cuts/trial_*"]', named), study="axis.yaml")
    played = metrics(backend, parameters, {"cuts": str(bags[0])})
    # The measure is a mean over the time, not over the messages.
    expected = optimum.surprise(heard, axis.Filter(*parameters.values()))
    assert played["surprise"] == pytest.approx(expected, rel=0.01)


def test_innovations_of_a_consistent_filter_have_the_law_of_chi_square(module_of):
    """Of an axis that has the variances of the filter; the limits of the examples are its."""
    assert float(f"{chi2.ppf(0.95, 1):.2f}") == 3.84
    assert float(f"{chi2.ppf(0.95, 2):.2f}") == 5.99
    axis = module_of(EXAMPLE, "axis")
    filter_, rng = axis.Filter(-3.0, 1e-3), np.random.default_rng(4)
    model, state = filter_.settings.model(), filter_.kalman.x[:, 0]
    squares = []
    for k in range(2000):
        command, noise = np.sin(0.05 * k), rng.normal(0.0, np.sqrt(1e-3), len(state))
        measured = float((model.C @ state)[0]) + rng.normal(0.0, np.sqrt(1e-3))
        _, innovation, variance = filter_.take(axis.MEASURED, 2 * k, measured)
        filter_.take(axis.COMMAND, 2 * k, command)
        squares.append(innovation**2 / variance)
        state = model.A @ state + model.B[:, 0] * command + noise
    assert kstest(squares, chi2(1).cdf).pvalue > 0.01
