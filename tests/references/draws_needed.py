"""How many draws without an event show a bound on its probability, by quadrature."""

import bisect
import math

from scipy import integrate


def evidence_by_quadrature(k, n, p):
    """Evidence of k events in n draws against a probability of p and more.

    With q' = p u²: the mean over u in (0, 1) of the likelihood ratio.
    """

    def ratio(u):
        q = p * u**2
        return math.exp(k * math.log(u**2) + (n - k) * (math.log1p(-q) - math.log1p(-p)))

    return integrate.quad(ratio, 0.0, 1.0, epsabs=0.0, epsrel=1e-10)[0]


def draws_needed_without_event(p, error):
    """Fewest draws, none with the event, whose evidence reaches 1 / error (Ville's inequality).

    For errors above 1e-7, since the evidence of 20 / p draws is about exp(20) sqrt(pi / 80).
    """
    return bisect.bisect_left(
        range(round(20.0 / p)), 1.0 / error, key=lambda n: evidence_by_quadrature(0, n, p)
    )
