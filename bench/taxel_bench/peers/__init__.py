"""Other libraries that evaluate the same model: each is an engine beside the published way and ours."""
