"""What the nodes of this workspace share of ROS: process, parameters and messages.

Python messages come with their field checks off, and a wrong type is then corrupted on the wire
without a word. The switch is read when the first message is imported, so it is set here, ahead of
all of them; an environment that sets it keeps its own value.
"""

import os

os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
