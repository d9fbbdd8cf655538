"""Search: hyperparameters found with SMAC3 in the paper's search spaces."""
