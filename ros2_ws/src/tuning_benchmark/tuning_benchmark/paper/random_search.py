"""Random search, Algorithm II of the paper."""

from collections.abc import Sequence

from bo_tuner.optimizers.base import RANDOM, DesignedOptimizer, Proposal
from bo_tuner.trials import Trial


class RandomSearch(DesignedOptimizer):
    """Random parameter sets after the initial design that all algorithms share."""

    def ask(self, pending: Sequence[Trial] = ()) -> Proposal:
        """Propose the parameter set of the next trial."""
        self.pending = tuple(pending)
        proposal = self.initial()
        if proposal is None:
            cube = self.space.latin_hypercube(1, self.rng())[0]
            proposal = Proposal(self.space.to_parameters(cube), RANDOM)
        return proposal
