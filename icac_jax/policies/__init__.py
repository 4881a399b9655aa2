"""What is made of trained policies: evaluations, films, pictures of maps, files. Importing this loads nothing."""

# Default of functions and commands; here, so that a help page need not load the functions.
PAIRS = 1000  # start and goal pairs per seed

SHIPPED = ("best-planar2", "best-nico4")
"""Trained policies that come with the package."""
