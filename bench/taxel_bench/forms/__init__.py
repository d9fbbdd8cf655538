"""What each evaluator of forests, and each special case within one, is worth."""
