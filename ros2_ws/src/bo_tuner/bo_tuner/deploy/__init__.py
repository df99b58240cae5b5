"""Deployment of a run's result: the bundle of files, and setting it on live nodes.

`bundle` collects the parameter file and the evidence, `apply` sets values on all nodes or none,
`live_parameters` calls the nodes' services.
"""
