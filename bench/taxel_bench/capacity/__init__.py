"""How many fingers one server carries, and what a request costs it."""
