"""What is tuned: the study, its file, its search space and its contexts."""
