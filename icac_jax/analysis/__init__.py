"""What was trained, looked at: runs beside each other, and the report of one run. Importing this loads nothing."""
