"""ROS parameters of a study's nodes.

`services`: those of one node, as ROS gives them; `messages`: their values. `events`: values that
nodes have and should not. `nodes`: what the nodes of a study are set to, and held at. `approach`:
the small steps there, if the study has a ramp. `at_rest`: what they have while no run is performed.
`previous`: what they had before, given back; `note`: the same on disk.
"""
