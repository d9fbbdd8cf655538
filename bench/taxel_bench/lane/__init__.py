"""One window over the lane: beside the call in process, beside a bare echo, and stage by stage."""
