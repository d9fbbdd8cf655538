"""`bench planted`: causes planted in files, and the names that the released commands give them."""
