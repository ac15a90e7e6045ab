"""Tool paths from files: CSV, G-code, APT."""
