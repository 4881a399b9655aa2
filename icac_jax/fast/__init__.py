"""What is written out for speed."""
