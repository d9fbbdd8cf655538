"""How many replicas of a server a fleet needs: a queueing simulation, from measured service times."""
