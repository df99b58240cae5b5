"""Acquisition functions: the value of evaluating a point next."""
