"""Parameter sets from files, above all from those of several nodes."""

from pathlib import Path

import pytest

from bo_tuner.errors import StudyError
from bo_tuner.storage.parameter_set_file import read_parameter_set


@pytest.fixture
def read(tmp_path, make_study):
    """Function that reads the gain of a node from a file of sections, each with a gain."""

    def gain(node, sections):
        lines = [f"{key}: {{ros__parameters: {{gain: {g}}}}}" for key, g in sections.items()]
        path = tmp_path / "nodes.yaml"
        path.write_text("\n".join(lines))
        study = make_study(nodes={"axis": {"node": node, "result": "~/r"}})
        return read_parameter_set(path, study)["gain"]

    return gain


def test_a_node_counts_in_any_namespace(read):
    assert read("axis", {"/cell/axis": 0.25, "/cell/other": 0.75}) == 0.25


def test_of_several_robots_the_one_in_the_study_counts(read):
    assert read("cell/axis", {"/cell/axis": 0.25, "/hall/axis": 0.75}) == 0.25


@pytest.mark.parametrize("key", ["/hall/axis", "/hall/**", "/**/hall/axis"])
def test_another_robot_is_not_taken_for_it(read, key):
    with pytest.raises(StudyError, match="has none of the study's parameters"):
        read("cell/axis", {key: 0.75})
    assert read("cell/axis", {key: 0.75, "/**/axis": 0.25}) == 0.25


def test_of_several_robots_none_of_which_is_meant(read):
    problem = "gain: has several values: of /cell/axis and of /hall/axis"
    with pytest.raises(StudyError, match=problem):
        read("axis", {"/cell/axis": 0.25, "/hall/axis": 0.75})
    assert read("axis", {"/cell/axis": 0.25, "/hall/axis": 0.25}) == 0.25


def test_of_several_sections_the_last_counts(read):
    assert read("axis", {"axis": 0.25, "/**": 0.75}) == 0.75
    assert read("axis", {"/**": 0.75, "axis": 0.25}) == 0.25
    assert read("axis", {"/**": 0.75}) == 0.75


def test_in_a_namespace_that_is_named_only_that_node_counts(tmp_path, make_study):
    path = tmp_path / "nodes.yaml"
    path.write_text(
        "cell: {axis: {ros__parameters: {gain: 0.25}}}\naxis: {ros__parameters: {gain: 0.75}}\n"
    )
    study = make_study(nodes={"axis": {"node": "axis", "result": "~/r"}})
    assert read_parameter_set(path, study)["gain"] == 0.75
    assert read_parameter_set(path, study, "/cell")["gain"] == 0.25
    with pytest.raises(StudyError, match="has none of the study's parameters"):
        read_parameter_set(path, study, "/hall")


def test_a_value_of_another_type_is_named(tmp_path, make_study):
    path = tmp_path / "nodes.yaml"
    path.write_text("axis:\n  ros__parameters:\n    load: 1\n    gain: on\n")
    with pytest.raises(StudyError, match=r"nodes\.yaml: gain: expected a number, found true"):
        read_parameter_set(path, make_study(nodes={"axis": {"node": "axis", "result": "~/r"}}))


def test_what_ros_refuses_is_refused_with_its_line(tmp_path, make_study):
    path = tmp_path / "nodes.yaml"
    path.write_text("axis:\n  ros__parameters: {gain: 0.5}\nfile: a.urdf\n")
    with pytest.raises(StudyError, match=r"nodes\.yaml:3: a value ahead of ros__parameters"):
        read_parameter_set(path, make_study())


FILES = Path(__file__).parent / "parameter_files"


@pytest.mark.parametrize(
    ("file", "node", "parameter", "namespace", "value"),
    [
        ("nav2_mppi_single_robot", "local_costmap/local_costmap",
         "inflation_layer.inflation_radius", "", 0.7),
        ("nav2_mppi_single_robot", "controller_server", "FollowPath.vx_std", "", 0.2),
        ("nav2_two_robots_nested_namespaces", "controller_server", "FollowPath.vx_std",
         "/robot2", 0.3),
        ("nav2_two_robots_nested_namespaces", "robot1/controller_server", "FollowPath.wz_std",
         "", 0.4),
        ("wildcard_after_specific", "pid", "kp", "", 9.0),
        ("wildcards_every_kind", "arm/pid", "kp", "", 3.0),
        ("yaml11_habits", "pid", "window", "", 8.0),
        ("jtc_per_joint_gains", "joint_trajectory_controller", "gains.joint2.p", "/", 250.0),
        ("ekf_full_matrix", "ekf_filter_node", "process_noise_covariance[16]", "", 0.05),
    ],
)  # fmt: skip
def test_files_in_the_layouts_of_the_field(make_study, file, node, parameter, namespace, value):
    constants = {"process_noise_covariance": [0.5] * 225} if "[" in parameter else {}
    gain = {"node": "axis", "parameter": parameter, "type": "double"}
    study = make_study(
        nodes={"axis": {"node": node, "result": "~/r", "parameters": constants}},
        parameters={"gain": gain | {"bounds": [0.0, 1000.0], "default": 1.0}},
    )
    path = FILES / f"{file}.yaml"
    assert read_parameter_set(path, study, namespace) == {"gain": value}
