"""The lane: plain frames over a local socket, for clients on the server's machine."""
