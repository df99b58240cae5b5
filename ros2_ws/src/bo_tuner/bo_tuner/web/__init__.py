"""The page of a run in progress: ``tune --web``.

The run sends what it does to a process of its own (`live_page`). That process makes the sections of
the report from the journal (`sections`) and serves them (`server`), so that neither delays the run.
"""
