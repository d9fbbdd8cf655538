"""The demo: a server, a simulated fingertip, and a client that replays it as a simulator would."""
