"""`bench choice`: accuracy, delay and latency of models beside each other."""
