"""Surrogate models: Gaussian process, Student-t process and nearest-neighbour classifiers."""
