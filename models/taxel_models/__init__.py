"""Where models come from: recordings, the twin, the model families, training and evaluation."""
