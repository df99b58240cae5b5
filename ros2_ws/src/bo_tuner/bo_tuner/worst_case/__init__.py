"""Worst-case search: the context in which a parameter set has the largest constrained metric."""
