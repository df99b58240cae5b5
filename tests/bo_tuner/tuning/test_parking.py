"""A run that waits is parked, and says what went wrong with that."""

from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.monitor import Gate
from bo_tuner.tuning.observer import Observers
from bo_tuner.tuning.parking import ParkInPause


class Asked(Interruption):
    """Ends each pause at the first look."""

    def __init__(self):
        self._request = None


def test_the_machine_is_parked_as_soon_as_a_run_pauses():
    said = []

    def park():
        said.append("parked")
        gate.requests.request(False)
        return ["pid is not parked: silent"]

    observers = Observers()
    observers.add(ParkInPause(park, said.append))
    gate = Gate(Asked(), observers)
    gate.evaluation(None)
    assert said == []
    gate.requests.request(True)
    gate.evaluation(None)
    assert said == ["parked", "warning: pid is not parked: silent"]
