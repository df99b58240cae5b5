"""The method `safe`."""
