"""From recordings to a trained model: windows, the held-out parts, fitting, and what is kept."""
