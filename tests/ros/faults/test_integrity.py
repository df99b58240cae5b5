"""What is on record was run with what the record says, whoever else talks to the nodes."""

import contextlib
import subprocess

import pytest
from commands import start
from diagnostic_msgs.msg import DiagnosticArray
from functions import planned
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue
from rclpy.duration import Duration
from waiting import DEADLINE

from bo_tuner import maxima
from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.parameters.messages import to_value
from bo_tuner.errors import BackendError
from bo_tuner.run_notes import Unusable
from bo_tuner.study.study_file import load_study, study_from_mapping, study_to_mapping
from bo_tuner.trials import EvaluationState

pytestmark = pytest.mark.ros

PACKAGES = ("milling_plant", "mpc_controller")
KEYS = {"milling_plant": "plant", "mpc_controller": "controller"}
CONTEXT = {"stiffness_factor": 1.125, "damping_factor": 0.875}

# Tuned, tied, constant, of the context, and not of the study at all.
CHANGES = [
    ("mpc_controller", "lambda_mpc", 0.5),
    ("mpc_controller", "return_time", "measured"),
    ("mpc_controller", "input_upper", 0.6),
    ("milling_plant", "stiffness_factor", 1.0),
    ("milling_plant", "samples_per_level", 30),
    ("milling_plant", "noise_variance", 0.02),
    ("milling_plant", "reference_levels", [0.1, 0.2]),
]


def make_study():
    mapping = study_to_mapping(load_study("full"))
    mapping["nodes"]["controller"]["parameters"] = {"return_time": "modelled"}
    mapping["nodes"]["plant"]["parameters"] = {"samples_per_level": 20, "command_timeout": 5.0}
    return study_from_mapping(mapping)


class Attached:
    """A backend on running nodes, and what somebody else does in the middle of an evaluation."""

    def __init__(self, folder, study, ros_arguments=None):
        self.study = study
        self.meanwhile = None
        self.backend = RosBackend(
            study,
            folder,
            attach=True,
            ros_arguments=ros_arguments,
            interrupted=self._interrupted,
        )

    def _interrupted(self):
        client = self.backend._client
        # From the trigger's answer on the evaluation runs.
        if self.meanwhile and client is not None and client.results._evaluation:
            act, self.meanwhile = self.meanwhile, None
            act()

    def run(self, seed=3, **parameters):
        values = dict(self.study.search_space().defaults) | parameters
        return self.backend.outcome(planned(values, CONTEXT, seed))


@pytest.fixture
def attach(client, tmp_path, monkeypatch):
    """Function that attaches to the pair of this module, which has its shipped parameters."""
    monkeypatch.setattr("bo_tuner.backends.ros.bringup.ATTACH_TIMEOUT", DEADLINE)
    with contextlib.ExitStack() as stack:

        def make(study=None):
            attached = Attached(tmp_path, study or make_study())
            stack.callback(attached.backend.close)
            try:
                attached.backend.open()
            except BackendError:
                attached.backend.close()
                raise
            return attached

        yield make


def in_process(study, seed=3, **parameters):
    backend = InProcessBackend(study)
    values = dict(study.search_space().defaults) | parameters
    with contextlib.closing(backend):
        backend.open()
        return backend.outcome(planned(values, CONTEXT, seed)).metrics


def expect_disturbed(outcome, node, name, value):
    assert outcome.state is EvaluationState.FAILED
    assert outcome.metrics == {}
    assert outcome.reason.startswith(f"{KEYS[node]}: parameter {name} is {value}, expected ")
    assert " (changed by someone else)" in outcome.reason
    assert outcome.unusable
    assert outcome.notes.unusable is Unusable.DISTURBED


class TestForeignChanges:
    def test_between_two_evaluations(self, attach, peer):
        """One is lost for each; then all parameters have their values again."""
        attached = attach()
        before = attached.run()
        assert before.metrics == in_process(attached.study)
        for node, name, value in CHANGES:
            assert peer.set_parameters(node, {name: value}).successful
            expect_disturbed(attached.run(), node, name, value)
            assert attached.run().metrics == before.metrics

    @pytest.mark.parametrize("back", [False, True], ids=["for good", "and back"])
    def test_during_an_evaluation(self, attach, peer, back):
        attached = attach()
        before = attached.run()
        for node, name, value in CHANGES:
            (original,) = peer.get_parameters(node, [name])

            def change(node=node, name=name, values=(value, original)):
                for each in values if back else values[:1]:
                    assert peer.set_parameters(node, {name: each}).successful

            attached.meanwhile = change
            outcome = attached.run()
            assert attached.meanwhile is None
            expect_disturbed(outcome, node, name, value)
            assert attached.run().metrics == before.metrics

    def test_the_same_value_again_is_no_change(self, attach, peer):
        attached = attach()
        before = attached.run()
        attached.meanwhile = lambda: peer.set_parameters(
            "mpc_controller", {"lambda_mpc": attached.study.search_space().defaults["lambda_mpc"]}
        )
        assert attached.run().metrics == before.metrics
        assert attached.meanwhile is None

    def test_a_refusal_for_which_somebody_else_is_to_blame(self, attach, peer):
        attached = attach()
        attached.run(control_horizon=5, prediction_horizon=10)
        assert peer.set_parameters(
            "mpc_controller", {"control_horizon": 9, "prediction_horizon": 20}
        ).successful
        outcome = attached.run(control_horizon=5, prediction_horizon=8)
        expect_disturbed(outcome, "mpc_controller", "control_horizon", 9)
        assert attached.run(control_horizon=5, prediction_horizon=8).metrics

    def test_what_a_live_node_had_is_restored(self, attach, peer):
        assert peer.set_parameters("mpc_controller", {"lambda_mpc": 0.25}).successful
        attached = attach()
        attached.run()
        attached.backend.close()
        assert peer.get_parameters("mpc_controller", ["lambda_mpc"]) == [0.25]

    def test_before_a_validation(self, attach, peer):
        """The next backend of a run does not take what it finds for what the run began with."""
        attach().backend.close()
        assert peer.set_parameters("milling_plant", {"noise_variance": 0.02}).successful
        expected = "plant: parameter noise_variance is 0.02, expected 0.001, as when the run began"
        with pytest.raises(BackendError, match=f"^{expected}; set it back, or if the node "):
            attach()
        assert peer.set_parameters("milling_plant", {"noise_variance": 0.001}).successful
        # What the study sets is the tuner's to set.
        assert peer.set_parameters("mpc_controller", {"lambda_mpc": 0.25}).successful
        assert attach().run().metrics


@pytest.mark.slow
class TestTwins:
    @pytest.mark.parametrize("package", PACKAGES)
    def test_at_the_start(self, attach, start_node, peer, package):
        start_node(package)
        peer.spin_until(
            lambda: peer.node.count_services(f"{package}/set_parameters_atomically") == 2, "both"
        )
        with pytest.raises(BackendError, match=f"^{package} runs more than once in ROS domain"):
            attach()

    @pytest.mark.parametrize("package", PACKAGES)
    def test_one_that_joins(self, attach, start_node, monkeypatch, package):
        """No evaluation has another result or is their parameters' failure; then each is named."""
        monkeypatch.setattr("bo_tuner.backends.ros.study_client.LONGEST_LEASE", 4.0)
        attached = attach()
        before = attached.run(lambda_mpc=-1.0)
        assert before.metrics == in_process(attached.study, lambda_mpc=-1.0)
        twin = start_node(package)
        named = f"{package} runs more than once in ROS domain "
        while not (outcome := attached.run(lambda_mpc=-1.0)).reason.startswith(named):
            # The plant may know of a second controller before the tuner does, and says so.
            assert outcome.unusable or outcome.metrics == before.metrics
        assert outcome.unusable
        assert attached.run(lambda_mpc=-1.0).reason.startswith(named)
        twin.end()
        while (outcome := attached.run(lambda_mpc=-1.0)).state is not EvaluationState.COMPLETE:
            assert outcome.unusable
        assert outcome.metrics == before.metrics


class TestOthers:
    def test_a_new_publisher_of_results_is_no_restart(self, attach, make_peer):
        attached = attach()
        before = attached.run()
        others = []

        def publish():
            other = make_peer()
            topic = "milling_plant/cut_result"
            others.append(other.node.create_publisher(DiagnosticArray, topic, 10))
            other.spin_until(lambda: others[-1].get_subscription_count() > 0, "the tuner")

        for _ in range(3):
            attached.meanwhile = publish
            assert attached.run().metrics == before.metrics
            assert attached.meanwhile is None

    @pytest.mark.parametrize(
        ("topic", "kind"),
        [("milling_plant/cut_result", DiagnosticArray), ("/parameter_events", ParameterEvent)],
        ids=["result", "event"],
    )
    def test_a_message_that_cannot_be_read(self, attach, peer, topic, kind):
        """One that is too large is not decoded, and of nobody knows what."""
        attached = attach()
        before = attached.run()
        publisher = peer.node.create_publisher(kind, topic, 10)
        peer.spin_until(lambda: publisher.get_subscription_count() > 0, "the tuner")
        named = "milling_plant: a result" if kind is DiagnosticArray else f"a message on {topic}"
        too_large = bytes(maxima.MESSAGE_BYTES + 1)

        def say(data):
            publisher.publish(data)
            assert publisher.wait_for_all_acked(Duration(seconds=DEADLINE))

        for data, complaint in (
            (too_large, "has 10000001 bytes, expected at most 10000000"),
            (b"\0\1\0\0" + b"\xff" * 50, f"cannot be read as {kind.__name__}"),
        ):
            attached.meanwhile = lambda data=data: say(data)
            outcome = attached.run()
            assert attached.meanwhile is None
            assert outcome.state is EvaluationState.FAILED
            assert outcome.reason == f"{named} {complaint}"
            assert outcome.unusable
            assert attached.run().metrics == before.metrics

    def test_a_value_of_unknown_type(self, attach, peer):
        attached = attach()
        before = attached.run()
        publisher = peer.node.create_publisher(ParameterEvent, "/parameter_events", 10)
        peer.spin_until(lambda: publisher.get_subscription_count() > 0, "the tuner")

        def say(name):
            value = ParameterValue(type=42)
            changed = [Parameter(name=name, value=value)]
            publisher.publish(ParameterEvent(node="/mpc_controller", changed_parameters=changed))
            assert publisher.wait_for_all_acked(Duration(seconds=DEADLINE))

        attached.meanwhile = lambda: say("of_no_use")
        assert attached.run().metrics == before.metrics
        attached.meanwhile = lambda: say("lambda_mpc")
        expect_disturbed(attached.run(), "mpc_controller", "lambda_mpc", "of unknown type 42")
        assert str(to_value(ParameterValue(type=42))) == "of unknown type 42"


@pytest.mark.slow
def test_nodes_with_more_threads_in_their_environment(peer, tmp_path, monkeypatch):
    """With two threads OpenBLAS sums the products of these horizons in another order."""
    monkeypatch.setattr("bo_tuner.backends.ros.bringup.ATTACH_TIMEOUT", DEADLINE)
    # Beside the pair of this module.
    arguments = ["--ros-args", "-r", "__ns:=/threads"]
    study = make_study()
    with contextlib.ExitStack() as stack:
        for package in PACKAGES:
            # By an interpreter of its own: the library reads the number when it is loaded.
            process = start(
                *arguments,
                folder=tmp_path,
                package=package,
                env={"OPENBLAS_NUM_THREADS": "2"},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            stack.callback(process.wait, DEADLINE)
            stack.callback(process.terminate)
            peer.get_parameters(f"threads/{package}", ["gain"])
        attached = Attached(tmp_path, study, arguments)
        stack.enter_context(contextlib.closing(attached.backend))
        attached.backend.open()
        for horizon in (15, 20):
            parameters = {
                "control_horizon": horizon,
                "prediction_horizon": 25,
                "lambda_mpc": -3.0,
            }
            assert attached.run(**parameters).metrics == in_process(study, **parameters)
