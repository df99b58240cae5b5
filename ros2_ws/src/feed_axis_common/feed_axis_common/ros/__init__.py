"""What the nodes of the feed axis share of ROS: process, parameters and messages.

Python messages do not check their fields by default, so that a value of a wrong type is silently
corrupted on the wire. The switch is read when the first message is imported, so it is set here,
ahead of all of them; a value that the environment already has is kept.
"""

import os

os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
