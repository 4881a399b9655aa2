"""A second implementation in float64 NumPy, sharing no code with the package."""
