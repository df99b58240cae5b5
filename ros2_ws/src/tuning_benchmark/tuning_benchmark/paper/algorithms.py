"""The Algorithms I to IV of the paper (Sec. 5.1), and V with a joint model.

setup.py offers them to the tuner.
"""

from tuning_benchmark.paper.check import CandidateCheck
from tuning_benchmark.paper.contexts import NominalContext
from tuning_benchmark.paper.method import PaperMethod
from tuning_benchmark.paper.random_search import RandomSearch
from tuning_benchmark.paper.searches import Joint, NoSearch
from tuning_benchmark.paper.trial_models import TrialModels, over_contexts

ALGORITHM_I = PaperMethod(
    contexts=NominalContext(), search=NoSearch(), searched=0, check=CandidateCheck(0)
)
ALGORITHM_II = PaperMethod(stage_one=RandomSearch)
ALGORITHM_III = PaperMethod(models=TrialModels(reject_outliers=False))
ALGORITHM_IV = PaperMethod()
ALGORITHM_V = PaperMethod(models=TrialModels(worst_case=over_contexts), search=Joint())
