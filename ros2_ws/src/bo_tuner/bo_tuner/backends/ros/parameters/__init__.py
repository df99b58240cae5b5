"""ROS parameters of a study's nodes.

`services`: those of one node, as ROS gives them. `events`: what nodes tell of changes. `nodes`:
what the nodes of a study are set to, and held at. `at_rest`: what they have while no run is
performed. `previous`: what they had before, noted and given back.
"""
