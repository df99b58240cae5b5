"""Bags of trials: what the nodes said to each other, in a form that standard tools open."""
