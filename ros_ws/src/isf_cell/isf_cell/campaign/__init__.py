"""Parts simulated in numbers: jobs, methods, variants and sheets in one table."""
