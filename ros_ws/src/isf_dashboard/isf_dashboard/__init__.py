"""A page in the browser for a running cell or a recorded part."""
