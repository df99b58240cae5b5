"""Methods by name: `boundary`, the default; `safe`; I to IV of the paper (Sec. 5.1); V, joint."""

from bo_tuner.methods.boundary.method import Boundary
from bo_tuner.methods.contexts import NominalContext
from bo_tuner.methods.paper.check import CandidateCheck
from bo_tuner.methods.paper.method import PaperMethod
from bo_tuner.methods.paper.random_search import RandomSearch
from bo_tuner.methods.paper.searches import Joint, NoSearch
from bo_tuner.methods.protocol import Method
from bo_tuner.methods.safe.method import Safe
from bo_tuner.models.trial_models import TrialModels, over_contexts
from bo_tuner.study.study import Study

BOUNDARY, SAFE = "boundary", "safe"
DEFAULT_METHOD = BOUNDARY

METHODS: dict[str, Method] = {
    "I": PaperMethod(
        "Bayesian optimization on the nominal model",
        contexts=NominalContext(),
        search=NoSearch(),
        searched=0,
        check=CandidateCheck(0),
    ),
    "II": PaperMethod("random sampling in stage one", stage_one=RandomSearch),
    "III": PaperMethod(
        "Bayesian optimization without outlier detection",
        models=TrialModels(reject_outliers=False),
    ),
    "IV": PaperMethod("Bayesian optimization with outlier detection"),
    "V": PaperMethod(
        "as IV, with one joint model of parameter set and context",
        models=TrialModels(worst_case=over_contexts),
        search=Joint(),
    ),
    BOUNDARY: Boundary(
        "search, then repeated runs at the boundary of the limits, all pooled in one joint model"
    ),
    SAFE: Safe("as boundary, in bounded steps among what is expected to keep all limits"),
}


def method_of(study: Study) -> str:
    """Return the name of the method of a study, unless the user names another one."""
    return DEFAULT_METHOD if study.safe_search is None else SAFE


def problem_of(name: str, study: Study) -> str:
    """Return in one line why a method cannot run a study; empty if it can."""
    problem = _problem(name, study)
    if not problem:
        return ""
    others = ", ".join(other for other in METHODS if not _problem(other, study))
    return f"{name} {problem}" + (f"; expected one of {others}" if others else "")


def _problem(name: str, study: Study) -> str:
    # What a machine must not go through stands in its study, and no option of a run passes over it.
    if study.safe_search is None and name == SAFE:
        return "needs `safe_search`, and the study has none"
    if study.safe_search is not None and name != SAFE:
        return "is no safe search, and the study has `safe_search`"
    return METHODS[name].problem(study)
