"""The recovery benchmark: injects known effects into recordings and counts which the loop finds."""
