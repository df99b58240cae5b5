"""The method `boundary`."""
