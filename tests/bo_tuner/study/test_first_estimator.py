"""A first study for an estimator that hears a bag: what is the truth, and what is alike."""

import pytest

from bo_tuner.study.descriptors import Described
from bo_tuner.study.first_estimator import HeardBag, first_estimator, task_of, tied
from bo_tuner.study.offers import parameter_offers, suggested_parameters
from bo_tuner.study.playing import Answer
from bo_tuner.study.seen import SeenNode, SeenTopic
from bo_tuner.study.study_file import parse_study

ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
IMU = "sensor_msgs/msg/Imu"
NUMBER = "std_msgs/msg/Float64"
HALF = Described("double", 0.5)


def odometry(name, turned=0.1, **ends):
    place = {f"pose.pose.position.{axis}": 0.0 for axis in "xyz"}
    turn = {"pose.pose.orientation.z": turned, "pose.pose.orientation.w": 1.0}
    return SeenTopic(name, ODOMETRY, place | turn | {"pose.covariance[0]": 0.2}, **ends)


def pose(name, turned=0.0):
    place = {f"pose.position.{axis}": 1.0 for axis in "xyz"}
    turn = {"pose.orientation.z": turned, "pose.orientation.w": 1.0}
    return SeenTopic(name, POSE, place | turn)


def number(name, **ends):
    return SeenTopic(name, NUMBER, {"data": 1.0}, **ends)


SENSED = SeenTopic("/imu", IMU, {"orientation.x": 0.0}, listeners=("ekf",))
ESTIMATE = odometry("/odom", publishers=("ekf",))


def of(*topics, outputs=(ESTIMATE,), named=()):
    return task_of(HeardBag((SENSED, *topics), outputs), named)


def written(node, task, bags=("a", "b"), bag=None):
    """The text of a study with all that is suggested, and the study."""
    taken = suggested_parameters(parameter_offers(node)[0])
    bag = bag or HeardBag((SENSED,), (ESTIMATE,), {"/imu": Answer(topic="/odom", every=2)})
    text = first_estimator("first.yaml", bags, bag, task, [node], taken)
    return text, parse_study(text.replace("bags: [a, b]", "distribution: discrete, values: [a, b]"))


@pytest.mark.parametrize(
    "name", ["/ground_truth", "/robot/gt", "/vicon/base", "/mocap_node/pose", "/rtk/pose", "/ref"]
)
def test_the_truth_by_name_and_type(name):
    task = of(odometry("/raw"), pose(name))
    assert (task.truth.name, task.known_by) == (name, "by its name")


def test_what_no_node_hears_and_has_a_pose_is_a_guess():
    task = of(pose("/tracker"))
    assert task.truth.name == "/tracker"
    assert "CHECK" in task.known_by
    # Of two nobody knows.
    assert of(pose("/tracker"), pose("/other")).truth is None
    # What the node hears is no truth, however it is called.
    heard = odometry("/gt", listeners=("ekf",))
    assert of(heard).truth is None


def test_a_topic_that_is_named_is_taken():
    task = of(pose("/vicon"), pose("/tracker"), named=["/tracker"])
    assert (task.truth.name, task.known_by) == ("/tracker", "named")
    other = odometry("/other")
    task = of(pose("/vicon"), outputs=(ESTIMATE, other), named=["/other"])
    assert (task.estimate, task.truth.name) == (other, "/vicon")


def test_a_pose_with_its_covariance_is_compared():
    node = SeenNode("ekf", {"q_noise": HALF}, command="ekf_node", is_estimator=True)
    text, study = written(node, of(odometry("/gt")))
    assert [*study.metrics] == ["error", "yaw_error", "consistent"]
    assert study.metrics["error"].truth == ("true_x", "true_y")
    assert study.signals["pyy"].field == "pose.covariance[7]"
    assert study.constraints["consistency"].lower == 0.85
    assert study.nodes["ekf"].command == "ekf_node"
    assert study.run.before[0].restarts == ("ekf",)
    assert "answers: {/imu: {topic: /odom, every: 2}}" in text


def test_a_truth_without_orientation_has_no_yaw():
    """That of an empty message is no heading."""
    node = SeenNode("ekf", {"q_noise": HALF}, is_estimator=True)
    text, study = written(node, of(pose("/gt")), bags=("a",))
    assert [*study.metrics] == ["error", "consistent"]
    assert study.run.play.bag == "a"
    assert not study.run.before
    assert "# before: [{restart: ekf}]" in text


def test_an_attitude_is_compared_by_roll_and_pitch():
    attitude = SeenTopic("/attitude", IMU, {"orientation.x": 0.1}, ("ekf",))
    turned = SeenTopic("/gt", POSE, pose("/gt").fields | {"pose.orientation.x": 0.1})
    node = SeenNode("madgwick", {"beta": HALF})
    _, study = written(node, of(turned, outputs=(attitude,)))
    assert study.signals["true_roll"].field == "roll(pose.orientation)"
    assert study.signals["pitch"].field == "pitch(orientation)"


def test_any_number_that_both_have_is_compared():
    node = SeenNode("kf", {"q": HALF})
    _, study = written(node, of(number("/truth"), outputs=(number("/estimate"),)))
    assert study.metrics["error"].of == "truth - estimate"
    assert study.signals["truth"].topic == "/truth"


def test_without_a_truth_the_innovation_is_taken():
    node = SeenNode("kf", {"q": HALF})
    innovation = number("/innovation")
    text, study = written(node, of(outputs=(ESTIMATE, innovation)))
    assert study.signals["estimate"].topic == "/innovation"
    assert "# likelihood: {of: log(s) + nu * nu / s, measure: mean}" in text
    text, study = written(node, of())
    assert study.objective.metric == "roughness"
    assert "says nothing of its error" in text
    assert task_of(HeardBag((SENSED,), ()), ()) is None


class TestVariances:
    def covariance(self, size, **values):
        """A diagonal matrix of ones but for some of its variances."""
        matrix = [float(i == j) for i in range(size) for j in range(size)]
        for name, value in values.items():
            matrix[int(name[1:]) * (size + 1)] = value
        return Described("double_array", matrix)

    def offers(self, **parameters):
        node = SeenNode("ekf", parameters, is_estimator=True)
        return {offer.name: offer for offer in parameter_offers(node)[0]}

    def ties(self, **parameters):
        taken = [offer for offer in self.offers(**parameters).values() if offer.suggested]
        return {offer.name: other.name for offer, other in tied(taken).items()}

    def test_of_a_matrix_the_diagonal_is_offered_by_its_logarithm(self):
        found = self.offers(process_noise_covariance=self.covariance(15, _2=0.0))
        assert [*found] == [f"process_noise_covariance[{16 * i}]" for i in range(15)]
        assert [name for name, offer in found.items() if not offer.suggested] == [
            "process_noise_covariance[32]"
        ]
        scales = {offer.fields.get("scale") for offer in found.values() if offer.suggested}
        assert scales == {"log"}
        # Of a matrix that is full, and of a list, nobody knows where the variances are.
        full = Described("double_array", [1.0] * 9)
        assert not any(offer.suggested for offer in self.offers(covariance=full).values())

    def test_x_and_y_are_alike(self):
        assert self.ties(covariance=self.covariance(6, _4=2.0)) == {
            "covariance[7]": "covariance[0]"
        }
        assert self.ties(covariance=self.covariance(2)) == {"covariance[3]": "covariance[0]"}
        assert self.ties(covariance=self.covariance(15)) == {
            f"covariance[{16 * row}]": f"covariance[{16 * (row - 1)}]" for row in (1, 4, 7, 10, 13)
        }

    def test_names_of_axes_are_alike(self):
        other = Described("double", 0.7)
        assert self.ties(noise_x=HALF, noise_y=HALF, noise_z=HALF) == {"noise_y": "noise_x"}
        assert self.ties(**{"q.vx": HALF, "q.vy": HALF}) == {"q.vy": "q.vx"}
        assert self.ties(roll_noise=HALF, pitch_noise=HALF) == {"pitch_noise": "roll_noise"}
        assert self.ties(noise_x=HALF, noise_y=other) == {}

    def test_they_are_tied_in_the_study(self):
        node = SeenNode("ekf", {"covariance": self.covariance(2)}, is_estimator=True)
        _, study = written(node, of(odometry("/gt")))
        assert study.parameters["covariance[3]"].tied_to == "covariance[0]"
        assert study.search_space().names == ("covariance[0]",)

    def test_what_a_start_sets_may_be_read_only(self):
        fixed = Described("double", 0.5, read_only=True)
        node = SeenNode("ekf", {"noise": fixed}, command="ekf_node", is_estimator=True)
        assert [offer.name for offer in parameter_offers(node)[0]] == ["noise"]
        # It is the node's own: without being an estimator it would be a plant's.
        assert parameter_offers(node)[0][0].suggested
