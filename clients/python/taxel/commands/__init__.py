"""The `taxel` command: its frame, and the commands that need no more than the client."""
