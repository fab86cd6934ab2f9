"""Elasto-plastic sheet: explicit shell elements, contact with tools and supports, clamped edge."""
