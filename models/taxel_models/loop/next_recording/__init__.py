"""What to record next, where a recording cannot tell two causes apart."""
