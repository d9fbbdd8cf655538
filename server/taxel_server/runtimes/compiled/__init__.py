"""What all compiled evaluators share: vectors, kernel arguments, compilation."""
