"""The search of the context in which parameters do worst."""
