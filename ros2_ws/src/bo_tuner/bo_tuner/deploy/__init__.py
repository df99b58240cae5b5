"""Deployment of a run's result: the bundle of files, setting it on nodes and in files.

`bundle` collects the parameter file and the evidence, `apply` sets values on all nodes or none,
`live_parameters` calls the nodes' services, `own_file` edits a user's parameter file.
"""
