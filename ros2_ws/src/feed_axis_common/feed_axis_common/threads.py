"""One thread for the numerics of a node.

The matrices are small, so more threads only get in each other's way. And a product that is split
among threads is summed in another order: with two threads a cut differs in the last digits from the
same cut with one. The libraries read the environment when they are loaded, so this comes ahead of
the import of NumPy.
"""

import os

VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def use_one_thread() -> None:
    """Let the linear algebra of this process use one thread, whatever the environment says."""
    os.environ.update(dict.fromkeys(VARIABLES, "1"))
