"""Evaluations on ROS nodes: their processes, their domain and the calls to them."""
