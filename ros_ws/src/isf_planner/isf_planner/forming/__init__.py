"""Which tool forms what, from which side and in how many stages."""
