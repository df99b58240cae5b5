"""Numerical building blocks, independent of tuning."""
