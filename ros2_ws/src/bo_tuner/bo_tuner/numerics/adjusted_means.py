"""The mean of a response, adjusted for what is known of its covariates: control variates.

A mean over n draws of a context scatters as the draws do: by chance more of them are heavy, or
cold. Of covariates h, functions of the context, the expectation over its distribution is known. In
the regression

    y = μ + βᵀ (h - E h) + ε

the estimate of μ is the mean of y less what the covariates explain of it (Lavenberg and Welch
1981), μ̂ = Σ wᵢ yᵢ, and what is behind its interval is the scatter of ε, not that of y. As the
response is no polynomial, ε has no mean of 0 at each h, so the standard error is the one that
takes neither that nor an equal variance for granted, √Σ (wᵢ eᵢ / (1 - lᵢ))² with the residuals e
and leverages l ("HC3", about the jackknife; MacKinnon and White 1985), with n - p - 1 degrees of
freedom. Without covariates it is Student's interval. The draws stay independent, so what is counted
in them, such as violations of a limit, needs no adjustment.

References
----------
Lavenberg and Welch (1981). A perspective on the use of control variables to increase the efficiency
of Monte Carlo simulations. Management Science 27(3).
MacKinnon and White (1985). Some heteroskedasticity-consistent covariance matrix estimators with
improved finite sample properties. Journal of Econometrics 29(3).
"""

from dataclasses import dataclass
from math import inf, nan, sqrt

import numpy as np
from scipy.special import stdtrit

from bo_tuner.numerics.arrays import Array

DEPENDENT = 1e-9
"""Share of the largest size up to which a column is a combination of the others by rounding."""


@dataclass(frozen=True)
class MeanInterval:
    """An estimate of an expectation, with an interval.

    Attributes
    ----------
    mean, error
        The estimate and its standard error; NaN of no value, and of too few.
    low, high
        Ends of the interval; infinite where the values are too few.
    adjusted
        Whether covariates were taken out.
    """

    mean: float
    error: float
    low: float
    high: float
    adjusted: bool = False


def adjusted_mean(values: Array, covariates: Array, confidence: float) -> MeanInterval:
    """Return the expectation of values, with an interval of a two-sided confidence.

    Parameters
    ----------
    values
        Shape (n,).
    covariates
        Shape (n, p), each with an expectation of 0; without any (p = 0) it is Student's interval.
    confidence
        Between 0 and 1.
    """
    n, p = covariates.shape
    degrees = n - p - 1
    if degrees < 1:
        return MeanInterval(float(values.mean()) if n else nan, nan, -inf, inf)
    # About the mean of the values: equal ones leave no residual.
    mean = float(values.mean())
    rest = values - mean
    error = float(values.std(ddof=1)) / sqrt(n)
    if p:
        basis, triangle = np.linalg.qr(np.column_stack([np.ones(n), covariates]))
        sizes = np.abs(np.diag(triangle))
        leverages = (basis**2).sum(axis=1)
        if sizes.min() <= DEPENDENT * sizes.max() or leverages.max() >= 1.0 - DEPENDENT:
            # By chance the draws do not tell the covariates apart.
            return adjusted_mean(values, covariates[:, :0], confidence)
        weights = basis @ np.linalg.solve(triangle.T, np.eye(p + 1)[0])
        residuals = rest - basis @ (basis.T @ rest)
        mean += float(weights @ rest)
        error = float(np.linalg.norm(weights * residuals / (1.0 - leverages)))
    half = float(stdtrit(degrees, 0.5 * (1.0 + confidence))) * error
    return MeanInterval(mean, error, mean - half, mean + half, adjusted=p > 0)
