"""One training in a folder: the host loop, records, checkpoints, resuming. Importing this loads nothing."""

# Default of functions and commands; here, so that a help page need not load the functions.
CHECKPOINT_EVERY = 60.0  # seconds
