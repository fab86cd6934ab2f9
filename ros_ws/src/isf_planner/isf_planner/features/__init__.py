"""Features of the part's surface: planes, ruled and freeform regions, ribs, and how they lie to each other."""
