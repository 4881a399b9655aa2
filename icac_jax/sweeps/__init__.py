"""Sweeps: many settings from one file, trained together wherever they share a program."""
