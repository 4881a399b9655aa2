"""The commands of `icac`, one module each: `main(args)` reads the arguments and returns the exit status."""
