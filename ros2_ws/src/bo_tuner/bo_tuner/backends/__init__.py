"""Where evaluations run: on ROS nodes, on plain objects in this process, or from a record."""
