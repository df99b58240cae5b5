"""What parameters are by their names, in the manner of nodes that are in use."""

import pytest

from bo_tuner.study.parameter_kinds import Kind, kinds
from bo_tuner.study.units import unit_in


def kinds_of(node, *names):
    return kinds(node, dict.fromkeys(names, ""))


@pytest.mark.parametrize(
    ("node", "names"),
    [
        ("pid", ("kp", "Ki", "kD", "p_gain", "antiwindup_gain", "pid.i", "d")),
        ("arm_controller", ("gains.joint1.p", "gains.ur/lift-joint.d", "gains.6_axis.i")),
        ("param", ("MC_ROLLRATE_P", "MC_ROLLRATE_I", "MC_ROLLRATE_D", "MC_ROLLRATE_K")),
        ("controller_server", ("FollowPath.vx_std", "FollowPath.gamma")),
        ("controller_server", ("FollowPath.PathAlign.cost_weight", "FollowPath.lookahead_dist")),
        ("costmap", ("inflation_layer.inflation_radius", "inflation_layer.cost_scaling_factor")),
        ("mpc", ("prediction_horizon", "output_weight", "goal_weight", "lambda_mpc")),
        ("ekf", ("process_noise", "measurement_noise", "initial_covariance")),
        ("state_observer", ("noise", "bandwidth")),
        ("speed", ("cutoff_frequency", "integral_time", "velocity_p", "tau")),
        ("admittance_controller", ("admittance.mass", "admittance.stiffness")),
        ("attitude", ("rate_kp", "kp_xy", "rateFeedForward")),
    ],
)
def test_gains_tell_of_tuning(node, names):
    assert kinds_of(node, *names) == dict.fromkeys(names, Kind.TUNING)


@pytest.mark.parametrize(
    ("node", "names"),
    [
        ("motor", ("inertia", "rotor_inertia", "friction", "noise", "sensor_delay")),
        ("robot", ("wheel_radius", "wheelRadius", "left_wheel_radius", "mass", "payload")),
        ("simulator", ("wind_speed", "measurement_noise", "motor_time_constant", "damping")),
        ("pid", ("kp", "mass")),
    ],
)
def test_properties_of_a_plant_are_no_gains(node, names):
    plant = [name for name in names if name != "kp"]
    found = kinds_of(node, *names)
    assert [found[name] for name in plant] == [Kind.PLANT] * len(plant)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("target_speed", Kind.SET_POINT),
        ("desired_linear_vel", Kind.SET_POINT),
        ("setpoint", Kind.SET_POINT),
        ("goal.x", Kind.SET_POINT),
        ("max_output", Kind.LIMIT),
        ("maxGain", Kind.LIMIT),
        ("FollowPath.vx_min", Kind.LIMIT),
        ("gains.joint1.i_clamp_max", Kind.LIMIT),
        ("i_clamp", Kind.LIMIT),
        ("xy_goal_tolerance", Kind.LIMIT),
        ("deadband_velocity", Kind.LIMIT),
        ("sample_time", Kind.TIMING),
        ("controller_frequency", Kind.TIMING),
        ("publish_rate", Kind.TIMING),
        ("cmd_vel_timeout", Kind.TIMING),
        ("model_dt", Kind.TIMING),
        ("dt", Kind.TIMING),
        ("stop_distance", Kind.DISTANCE),
        ("approach_velocity_scaling_dist", Kind.DISTANCE),
        ("batch_size", Kind.COUNT),
        ("can_id", Kind.COUNT),
        ("offset", Kind.UNKNOWN),
        ("COM_RC_IN_MODE", Kind.UNKNOWN),
    ],
)
def test_set_points_limits_and_periods_are_no_gains(name, kind):
    assert kinds_of("controller", "kp", name) == {"kp": Kind.TUNING, name: kind}


def test_where_a_name_may_be_of_both_its_neighbours_tell():
    """A time constant is a motor's, or that of a filter; beside both nothing is known."""
    assert kinds_of("a", "time_constant", "mass")["time_constant"] is Kind.PLANT
    assert kinds_of("a", "time_constant", "kp")["time_constant"] is Kind.TUNING
    assert kinds_of("a", "time_constant", "kp", "mass")["time_constant"] is Kind.UNKNOWN


def test_a_name_that_tells_nothing_is_read_with_its_description():
    said = {
        "a1": "Proportional gain of the roll axis",
        "a2": "weight of the vehicle [kg]",
        "weight": "of the vehicle [kg]",
        "a3": "of the filter, beside the gain",
        "kp": "of the mass",
    }
    assert kinds("node", said) == {
        "a1": Kind.TUNING,
        "a2": Kind.PLANT,
        "weight": Kind.PLANT,
        "a3": Kind.TUNING,
        "kp": Kind.TUNING,
    }


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("gain [V/rad]", "V/rad"),
        ("proportional gain [N m/(rad s)], of the inner loop", "N m/(rad s)"),
        ("mass of the load (kg)", "kg"),
        ("[kg m²]", "kg m²"),
        ("cutoff [1/s]", "1/s"),
        ("[m s^-2]", "m s^-2"),
        ("share [%]", "%"),
        ("in the range [0, 1]", ""),
        ("between [min, max]", ""),
        ("joint(s) to move", ""),
        ("ratio [-]", ""),
        ("ratio [1]", ""),
        ("[N/A]", ""),
        ("see [1] (as in the manual)", ""),
        ("range [0, 1], in [s]", "s"),
        ("", ""),
    ],
)
def test_the_unit_in_a_description(text, unit):
    assert unit_in(text) == unit
