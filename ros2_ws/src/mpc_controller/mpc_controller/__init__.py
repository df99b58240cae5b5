"""Kalman filter and model predictive controller of a feed axis, and their ROS 2 node."""
