"""`bench simulator`: what fingertips cost a simulation."""
