"""The loops of force and compliance control with their filter, and their limits of stability."""
