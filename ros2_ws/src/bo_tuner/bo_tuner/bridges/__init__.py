"""Other packages, each in a module of its own, which imports it: an extra."""
