"""A run that waits is parked, and says what went wrong with that."""

from bo_tuner.tuning.gate import Gate
from bo_tuner.tuning.observer import Observers
from bo_tuner.tuning.parking import ParkInPause


def test_the_machine_is_parked_as_soon_as_a_run_pauses():
    said = []

    def park():
        said.append("parked")
        gate.requests.request(False)
        return ["pid is not parked: silent"]

    observers = Observers()
    observers.add(ParkInPause(park, said.append))
    gate = Gate(observer=observers)
    gate.wait()
    assert said == []
    gate.requests.request(True)
    gate.wait()
    assert said == ["parked", "warning: pid is not parked: silent"]


def test_a_machine_that_was_not_parked_is_parked_again_as_long_as_the_pause_lasts(monkeypatch):
    monkeypatch.setattr("bo_tuner.tuning.parking.AGAIN", 0.0)
    said, tried = [], []
    ends = {4: []}

    def park():
        tried.append(True)
        return ends.get(len(tried), ["pid is not parked: silent"])

    observer = ParkInPause(park, said.append)
    observer.waiting()
    assert tried == []
    observer.pause(True)
    for _ in range(9):
        observer.waiting()
    assert len(tried) == 4
    assert said == [
        "warning: pid is not parked: silent",
        "the nodes have their safe parameters now",
    ]
    observer.pause(False)
    observer.waiting()
    assert len(tried) == 4
