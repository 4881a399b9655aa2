"""The command line `icac`. Importing this loads neither JAX nor physics."""
