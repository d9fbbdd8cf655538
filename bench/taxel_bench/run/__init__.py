"""`bench run`: one model in this process, our runtime and the published way in turn."""
