"""From recordings to a trained model: windows, held-out rows, fitting, and the files."""
