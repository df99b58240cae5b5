"""The method of a run on record."""

from bo_tuner.methods.protocol import Method
from bo_tuner.methods.registry import METHODS
from bo_tuner.storage.record import RunRecord


def recorded_method(record: RunRecord) -> Method:
    """Return the method of a run, with the simulation that it knows."""
    method = METHODS[record.algorithm]
    return method.knowing(record.study, record.simulation) if record.simulation else method
