"""The `taxel` command line, and the commands that need only the client."""
