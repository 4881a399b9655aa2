"""Experiments: settings, run folders, the command line. Importing this loads no physics."""

# Defaults that both Python functions and commands have; here, so that a help page need not load the functions.
CHECKPOINT_EVERY = 60.0  # seconds
PAIRS = 1000  # start and goal pairs a seed
