"""The nodes' parameter services."""

import math

import pytest
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.parameter import Parameter

from feed_axis_common.parameters import specifications
from milling_plant.settings import PlantSettings
from milling_plant.settings import default_settings as plant_defaults
from mpc_controller.settings import ControllerSettings
from mpc_controller.settings import default_settings as controller_defaults

pytestmark = pytest.mark.ros

TABLES = {
    "milling_plant": (PlantSettings, plant_defaults()),
    "mpc_controller": (ControllerSettings, controller_defaults()),
}
TYPES = {
    bool: ParameterType.PARAMETER_BOOL,
    int: ParameterType.PARAMETER_INTEGER,
    float: ParameterType.PARAMETER_DOUBLE,
    str: ParameterType.PARAMETER_STRING,
    tuple: ParameterType.PARAMETER_DOUBLE_ARRAY,
}


@pytest.mark.parametrize("node", TABLES)
def test_every_parameter_is_described_by_type_range_unit_and_text(client, node):
    table, defaults = TABLES[node]
    specs = specifications(table)
    answer = client.call(
        DescribeParameters,
        f"{node}/describe_parameters",
        DescribeParameters.Request(names=[spec.name for spec in specs]),
    )
    for spec, found in zip(specs, answer.descriptors, strict=True):
        assert found.name == spec.name
        assert found.type == TYPES[spec.kind]
        assert found.description.startswith(spec.text)
        assert found.description.endswith(f"[{spec.unit}]" if spec.unit else spec.text)
        if spec.kind is int:
            (span,) = found.integer_range
            assert (span.from_value, span.to_value) == (spec.lower, spec.upper)
        if spec.kind is float:
            (span,) = found.floating_point_range
            assert (span.from_value, span.to_value) == (spec.lower, spec.upper)
        for choice in spec.choices:
            assert choice in found.additional_constraints

    values = client.get_parameters(node, [spec.name for spec in specs])
    for spec, value in zip(specs, values, strict=True):
        expected = getattr(defaults, spec.name)
        assert (tuple(value) if spec.kind is tuple else value) == expected


@pytest.mark.parametrize("node", TABLES)
def test_nothing_is_declared_beside_the_table(client, node):
    answer = client.call(ListParameters, f"{node}/list_parameters", ListParameters.Request())
    names = {spec.name for spec in specifications(TABLES[node][0])}
    assert set(answer.result.names) - names <= {"use_sim_time", "start_type_description_service"}


REFUSED = [
    ("mpc_controller", {"lambda_mpc": math.nan}, "lambda_mpc: nan is not finite"),
    ("mpc_controller", {"lambda_mpc": math.inf}, "lambda_mpc: inf is not finite"),
    ("mpc_controller", {"lambda_mpc": 8.001}, "lambda_mpc: 8.001 is above the upper limit 8"),
    ("mpc_controller", {"lambda_mpc": "small"}, "lambda_mpc: 'small' is not a number"),
    ("mpc_controller", {"lambda_mpc": True}, "lambda_mpc: True is not a number"),
    ("mpc_controller", {"control_horizon": 3.0}, "control_horizon: 3.0 is not an integer"),
    ("mpc_controller", {"control_horizon": "3"}, "control_horizon: '3' is not an integer"),
    (
        "mpc_controller",
        {"control_horizon": 0},
        "control_horizon: 0 is below the lower limit 1 samples",
    ),
    (
        "mpc_controller",
        {"prediction_horizon": 14},
        "prediction_horizon: 14 is below control_horizon 15; it must be at least as long",
    ),
    (
        "mpc_controller",
        {"input_upper": -0.5},
        "input_upper: -0.5 is not above input_lower 0.0 m/s",
    ),
    (
        "mpc_controller",
        {"return_time": "guessed"},
        "return_time: 'guessed' is not one of measured, cpu, modelled",
    ),
    (
        "mpc_controller",
        {"estimate_disturbance": 1},
        "estimate_disturbance: 1 is not true or false",
    ),
    ("mpc_controller", {"no_such": 1.0}, "no_such: unknown parameter; expected one of "),
    ("milling_plant", {"seed": -1}, "seed: -1 is below the lower limit 0"),
    ("milling_plant", {"stiffness_factor": -math.inf}, "stiffness_factor: -inf is not finite"),
    ("milling_plant", {"reference_levels": [0.5, math.nan]}, "reference_levels: nan is not finite"),
    (
        "milling_plant",
        {"reference_levels": [0.5, 1e7]},
        "reference_levels: 10000000.0 is above the upper limit 1000000.0 m/s",
    ),
    ("milling_plant", {"reference_levels": ["a"]}, "reference_levels: 'a' is not a number"),
    ("milling_plant", {"dead_time": 9.0}, "dead_time: 9.0 is above 100 sample times of 0.02 s"),
]


@pytest.mark.parametrize("node", TABLES)
def test_bad_values_are_refused_with_value_and_rule_and_change_nothing(client, node):
    harmless = {"milling_plant": "damping_factor", "mpc_controller": "lambda_kf"}[node]
    names = [spec.name for spec in specifications(TABLES[node][0])]
    before = client.get_parameters(node, names)
    for values, reason in [case[1:] for case in REFUSED if case[0] == node]:
        result = client.set_parameters(node, {harmless: 1.5} | values)
        assert not result.successful, values
        assert result.reason.startswith(reason)
        assert client.get_parameters(node, names) == before, values


def test_a_parameter_cannot_be_deleted(client):
    unset = ParameterMessage(
        name="lambda_mpc", value=ParameterValue(type=ParameterType.PARAMETER_NOT_SET)
    )
    for service in (SetParameters, SetParametersAtomically):
        name = "set_parameters" + ("_atomically" if service is SetParametersAtomically else "")
        answer = client.call(service, f"mpc_controller/{name}", service.Request(parameters=[unset]))
        result = answer.result if service is SetParametersAtomically else answer.results[0]
        assert not result.successful
        assert result.reason == "lambda_mpc: cannot be deleted"
        assert client.get_parameters("mpc_controller", ["lambda_mpc"]) == [-3.0]


def test_a_truth_value_is_set(client):
    assert client.set_parameters("mpc_controller", {"estimate_disturbance": True}).successful
    assert client.get_parameters("mpc_controller", ["estimate_disturbance"]) == [True]


def test_a_whole_number_is_taken_for_a_double(client):
    assert client.set_parameters("mpc_controller", {"lambda_mpc": -2, "lambda_kf": 1}).successful
    values = client.get_parameters("mpc_controller", ["lambda_mpc", "lambda_kf"])
    assert values == [-2.0, 1.0]
    assert all(isinstance(value, float) for value in values)


def test_whole_numbers_are_taken_in_a_list(client):
    assert client.set_parameters("milling_plant", {"reference_levels": [1, 0]}).successful
    (levels,) = client.get_parameters("milling_plant", ["reference_levels"])
    assert list(levels) == [1.0, 0.0]
    assert all(isinstance(level, float) for level in levels)


def test_ros_own_parameters_can_still_be_set(client):
    assert client.set_parameters("mpc_controller", {"use_sim_time": True}).successful
    assert client.set_parameters("mpc_controller", {"use_sim_time": False}).successful


def test_parameters_that_are_right_only_together_are_set_together(client):
    values = {"control_horizon": 20, "prediction_horizon": 25}
    request = SetParameters.Request(
        parameters=[Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
    )
    # One at a time, the first alone breaks the rule; the second is right by itself.
    answer = client.call(SetParameters, "mpc_controller/set_parameters", request)
    assert [result.successful for result in answer.results] == [False, True]
    assert client.set_parameters("mpc_controller", values).successful


def test_the_same_parameter_twice_takes_the_last(client):
    request = SetParametersAtomically.Request(
        parameters=[Parameter("lambda_mpc", value=v).to_parameter_msg() for v in (-1.0, -2.0)]
    )
    answer = client.call(
        SetParametersAtomically, "mpc_controller/set_parameters_atomically", request
    )
    assert answer.result.successful
    assert client.get_parameters("mpc_controller", ["lambda_mpc"]) == [-2.0]


def test_an_unknown_name_among_known_ones_is_answered_by_no_values(client):
    answer = client.call(
        GetParameters,
        "mpc_controller/get_parameters",
        GetParameters.Request(names=["lambda_mpc", "no_such"]),
    )
    assert len(answer.values) == 0
    assert client.get_parameters("mpc_controller", ["lambda_mpc"]) == [-3.0]
