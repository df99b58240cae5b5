"""What a machine needs around a run: each need a function around one, tested without ROS."""
