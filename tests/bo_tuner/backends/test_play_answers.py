"""Which messages of a bag are answered."""

from bo_tuner.backends.ros.play.answering import answers
from bo_tuner.study.playing import Answer


def test_each_message_or_each_kth_one():
    sent = {"/clock": 200, "/imu": 100, "/points": 40, "/fix": 10, "/odd": 100}
    answered = {
        ("/clock", "/diagnostics"): 200,
        ("/imu", "/pose"): 98,
        ("/imu", "/path"): 50,
        ("/points", "/map"): 20,
        ("/fix", "/pose"): 2,
        # Neither each one nor each second one.
        ("/odd", "/pose"): 70,
    }
    assert answers(sent, answered) == {
        "/imu": Answer(topic="/pose"),
        "/points": Answer(topic="/map", every=2),
    }
