"""The files people write: jobs, rigs, materials and response surfaces, checked and in SI units."""
