"""A trajectory and an estimate of it, and what the package evo makes of them.

evo (M. Grupp, https://github.com/MichaelGrupp/evo, GPL 3.0) is no requirement. In an environment of
its own, with evo 1.38.1, these numbers are of

    python evo_trajectories.py          # writes truth.tum and estimate.tum
    evo_ape tum truth.tum estimate.tum
    evo_ape tum truth.tum estimate.tum --align
    evo_rpe tum truth.tum estimate.tum --delta 20 --delta_unit f --all_pairs
"""

import numpy as np

TIMES = 0.05 * np.arange(400)
TRUTH = np.column_stack([6.0 * np.sin(0.4 * TIMES), 3.0 * np.sin(0.8 * TIMES), 0.4 * TIMES])
"""Poses (400, 3): x, y [m] and yaw [rad]; it turns as it likes."""
ESTIMATE = np.column_stack(
    [
        TRUTH[:, 0] + 0.2 * np.sin(1.7 * TIMES) + 0.3,
        TRUTH[:, 1] * 1.05 - 0.1 * TIMES**0.5,
        TRUTH[:, 2] + 0.1 * np.cos(0.9 * TIMES) + 0.2,
    ]
)
ABSOLUTE = {"max": 0.656826, "mean": 0.445108, "median": 0.470366, "rmse": 0.467088}
ALIGNED = {"max": 0.341083, "mean": 0.192161, "median": 0.185605, "rmse": 0.205259}
RELATIVE = {"max": 1.237253, "mean": 0.499371, "median": 0.462045, "rmse": 0.587375}
"""Of the translation, in metres; the last one over 20 samples, which are 1 s."""

if __name__ == "__main__":
    for name, poses in (("truth", TRUTH), ("estimate", ESTIMATE)):
        zero, half = np.zeros(len(TIMES)), 0.5 * poses[:, 2]
        columns = [TIMES, *poses[:, :2].T, zero, zero, zero, np.sin(half), np.cos(half)]
        np.savetxt(f"{name}.tum", np.column_stack(columns), fmt="%.15g")
