"""The cell: executive, in-process cell and the ``isf`` command."""
