"""Intermediate shapes between the flat blank and a part, by morphing the part (Behera 2015)."""
