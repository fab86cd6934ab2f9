"""What each subcommand of ``isf`` does."""
