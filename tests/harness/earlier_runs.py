"""Records of runs of a function, as an earlier run that another one takes trials of."""

from functions import NODE

from bo_tuner.methods.registry import METHODS
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.session_options import SessionOptions
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning

BOUNDARY = "boundary"
GAIN = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
LOAD = NODE | {"distribution": "uniform", "bounds": [1.0, 2.0]}
PEAK = {"kind": "worst_case", "metric": "peak", "upper": 1.0}


def machine(gain, load, **_):
    """Without noise: the error falls towards a gain of 1.5, the peak grows with gain and load."""
    return {
        "error": (gain - 1.5) ** 2 + 0.1 * load,
        "peak": 0.5 * gain * load,
        "effort": 3.0 * gain,
    }


def record(tmp_path, study, backend, algorithm=BOUNDARY, trials=None):
    """A run of a study, as it is read."""
    if trials is None:
        trials = list(Tuning(study, Driver(backend(study, machine)), METHODS[algorithm]))
    evaluations = tuple(e for trial in trials for e in trial.evaluations)
    return RunRecord(
        path=tmp_path / "earlier",
        study=study,
        algorithm=algorithm,
        backend="inprocess",
        options=SessionOptions(),
        provenance={},
        trials=tuple(trials),
        evaluations=evaluations,
        summary=None,
        damage="",
    )
