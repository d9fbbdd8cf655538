"""Loads a repository while a server runs, and tries artifacts out in processes that can be killed."""
