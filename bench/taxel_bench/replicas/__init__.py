"""`bench replicas`: several servers under load while one is killed, stopped or restarted."""
