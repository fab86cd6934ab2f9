"""Contact-force control and compliance compensation of the two tools of a forming cell."""
