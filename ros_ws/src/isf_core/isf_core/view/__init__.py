"""Pictures in three dimensions that are turned in a browser."""
