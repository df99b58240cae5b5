"""What a campaign compares: the content of an experiment file."""
