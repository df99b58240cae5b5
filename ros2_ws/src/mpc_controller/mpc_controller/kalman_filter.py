"""The state estimator of Sec. 2: a Kalman filter on the dead-time-augmented model.

The paper's model has no disturbance. On a model with one the same filter estimates it, too; how
fast is a ratio of covariances.
"""

import numpy as np
from filterpy.kalman import KalmanFilter

from feed_axis_common.model import Array, DiscreteModel


def kalman_filter(
    model: DiscreteModel,
    measurement_variance: float,
    lambda_kf: float,
    x0: Array,
    lambda_disturbance: float = 0.0,
) -> KalmanFilter:
    """Set up filterpy's filter with R_KF = measurement_variance and Q_KF = I 10^lambda_kf.

    The disturbance of a model that has one is a random walk with 10^lambda_disturbance times the
    variance of the other states.

    Parameters
    ----------
    model
        Model with n states and one measured output.
    measurement_variance
        R_KF [(m/s)^2].
    lambda_kf
        Exponent of the process noise covariance, which acts on all n states alike, past inputs
        included.
    x0
        State (n,) before the first measurement. Its covariance starts at Q_KF: the initial state
        is known as well as the model is trusted over one step.
    lambda_disturbance
        Exponent of that factor; without effect on a model without a disturbance.

    Returns
    -------
    filterpy.kalman.KalmanFilter
        Call ``update(y)`` with the measurement of a sample, then ``predict(u)`` with the command
        given in it.
    """
    n = model.A.shape[0]
    kf = KalmanFilter(dim_x=n, dim_z=1, dim_u=1)
    kf.F = model.A
    kf.B = model.B
    kf.H = model.C
    kf.Q = np.eye(n) * 10.0**lambda_kf
    if model.disturbance is not None:
        kf.Q[model.disturbance, model.disturbance] *= 10.0**lambda_disturbance
    kf.R = np.array([[measurement_variance]])
    kf.P = kf.Q.copy()
    kf.x = x0.reshape(n, 1).copy()
    return kf
