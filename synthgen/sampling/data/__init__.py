"""Small tables that sampling needs, each with the script that made it."""
