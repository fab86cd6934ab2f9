"""How the tools move: paths, trajectories, moves without forming, segments and their playback."""
