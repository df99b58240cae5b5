"""Simulated feed axis of a milling centre, and its ROS 2 node."""
