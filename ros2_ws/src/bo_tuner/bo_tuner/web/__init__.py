"""The page of a run in progress: ``tune --web``.

The run tells a process of its own what it does (`live_page`). That process makes the sections of
the report from the journal (`sections`) and serves them (`server`), so that neither delays the run.
"""
