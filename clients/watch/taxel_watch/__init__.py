"""`taxel watch`: the fingertip as a page, in a terminal, or in other viewers."""
