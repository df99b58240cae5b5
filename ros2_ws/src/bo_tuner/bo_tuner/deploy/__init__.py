"""From a run's result to the machine: the bundle that carries it, and the way onto live nodes.

`parameter_file` writes what nodes load, `bundle` puts it together with the evidence, `apply`
decides and checks, `live_parameters` talks to the nodes.
"""
