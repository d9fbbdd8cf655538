"""What the loop found as a folder to read: figures, text and pictures; and as a table for the terminal."""
