"""Servers and clients that run in processes of their own, most under a peer's interpreter.

There, nothing of Taxel is installed: apart from `taxel_client`, these programs use only the peer's
packages and each other.
"""
