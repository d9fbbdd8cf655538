"""How requests reach the server's core: each transport turns what it receives into jobs."""
