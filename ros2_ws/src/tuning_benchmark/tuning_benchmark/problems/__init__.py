"""Robust problems in closed form, with known optimum."""
