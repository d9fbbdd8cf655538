"""Clients that come, send large requests and go, or are killed: what they leave in the server."""
