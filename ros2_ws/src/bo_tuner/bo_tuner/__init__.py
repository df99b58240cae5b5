"""Bayesian optimization of the parameters of ROS 2 nodes, robust against a changing context."""
