"""From a trained model to an artifact that a server loads, checked against each other."""
