"""The answer of a method after some trials, with as many checks or repetitions as a test wants."""

from dataclasses import replace

from bo_tuner.methods.registry import METHODS
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.observer import NOBODY
from bo_tuner.tuning.summary import choose_answer
from tuning_benchmark.paper.check import CandidateCheck


def recommend(study, backend, trials, method="IV", *, most_checked=6, observer=NOBODY):
    """The answer of a method that checks its candidates."""
    checking = replace(METHODS[method], check=CandidateCheck(most_checked))
    return choose_answer(study, Driver(backend, observer), checking, trials)


def settle(study, backend, trials, *, most, observer=NOBODY):
    """The answer of `boundary` after at most so many repetitions."""
    method = METHODS["boundary"]
    return choose_answer(study, Driver(backend, observer), method, trials, most_repeated=most)
