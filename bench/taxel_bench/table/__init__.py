"""`bench table`: the paper's inference table again, with our runtime beside it."""
