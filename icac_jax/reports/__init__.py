"""Results, statistics, tables."""
