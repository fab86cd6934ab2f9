"""The report of one part as an HTML page."""
