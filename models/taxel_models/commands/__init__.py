"""The `taxel` commands that need recordings or models: one file each."""
