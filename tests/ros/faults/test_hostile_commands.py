"""Commands that do not belong to the present sample, in a plant's way."""

import pytest
from builtin_interfaces.msg import Time
from cuts import Constant
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from milling_plant.cut import MillingPlant

pytestmark = [pytest.mark.ros, pytest.mark.slow]

SHORT = {"reference_levels": [0.5], "samples_per_level": 4, "seed": 1}
any_text = st.text(max_size=30) | st.sampled_from(["x_axis", "x" * 100_000])
any_state = st.builds(
    JointState,
    header=st.builds(
        Header,
        stamp=st.builds(
            Time, sec=st.integers(-(2**31), 2**31 - 1), nanosec=st.integers(0, 2**32 - 1)
        ),
        frame_id=any_text,
    ),
    name=st.lists(any_text, max_size=3),
    velocity=st.lists(st.floats() | st.sampled_from([1e308, -1e308, 5e-324]), max_size=3),
)


@pytest.fixture
def controller(stand_in_controller):
    """The one in the controller's place for all examples: each further one would answer, too."""
    return stand_in_controller(**SHORT)


# The text of a failing example is that long.
@pytest.mark.filterwarnings("ignore:Generating overly large repr")
@settings(
    max_examples=15,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    # Shrinking would run the node through hundreds of further cases.
    phases=[Phase.explicit, Phase.generate],
)
@given(messages=st.lists(any_state, min_size=1, max_size=5))
def test_any_commands_leave_the_cut_as_it_is(controller, messages):
    """All but one for the present sample, which none of these can be by chance."""
    plain = MillingPlant()
    plain.set_parameters(SHORT)
    expected = plain.run_cut(Constant(0.6))

    def answer(measurement):
        for message in messages:
            controller.command.publish(message)
        return [(measurement.header.stamp, 0.6)]

    controller.answer = answer
    values, _ = controller.run_cut()
    assert values["status"] == "ok"
    assert float(values["tracking_error"]) == expected["tracking_error"]
    # Those of the last sample may come after the end.
    assert int(values["ignored_messages"]) >= 3 * len(messages)
