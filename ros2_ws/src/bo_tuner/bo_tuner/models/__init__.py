"""Surrogate models: Gaussian processes of trials or of all evaluations, and classifiers."""
