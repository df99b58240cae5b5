"""Robust problems in closed form, whose optimum is known."""
