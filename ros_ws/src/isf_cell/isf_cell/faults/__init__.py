"""The fault campaign ``isf faults``: cells of real processes, disturbed from outside, and judged from outside."""
