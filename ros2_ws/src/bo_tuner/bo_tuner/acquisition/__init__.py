"""Acquisition functions: what a further evaluation of a point is worth."""
