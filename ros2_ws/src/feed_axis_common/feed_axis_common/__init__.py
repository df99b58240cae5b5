"""What the nodes of the feed axis share: model, parameter tables and ROS plumbing."""
