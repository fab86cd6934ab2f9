"""A recorded part fed to the controllers again: what they decide with the same or with other parameters."""
