"""The host side: settings, the training loop, run folders, summaries, the command line."""
