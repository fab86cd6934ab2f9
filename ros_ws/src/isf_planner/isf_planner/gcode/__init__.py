"""Programs in: G-code to points, to contours, checked as a plan is."""
