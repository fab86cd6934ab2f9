"""What a plan will do to sheet and machine, and compensation without feedback."""
