"""`bench forms`: measures what each evaluator of forests, and each special case, is worth."""
