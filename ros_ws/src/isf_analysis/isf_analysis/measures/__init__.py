"""What is known of one formed part, and its numbers."""
