"""Other tools that show a source: Rerun, Foxglove, and what reads MCAP files."""
