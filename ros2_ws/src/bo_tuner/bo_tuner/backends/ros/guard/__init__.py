"""The guard of a machine: a process of its own that leaves the nodes safe if the tuner does not.

`plan` says what it holds, `watch` decides when it acts, `guard` is the process with its ROS node,
and `link` the tuner's connection to it; `messages` is what the two send each other.
"""
