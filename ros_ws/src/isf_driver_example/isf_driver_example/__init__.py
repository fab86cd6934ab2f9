"""A driver to start from: :mod:`isf_driver_example.driver_node` stays, ``hardware.py`` is where your own calls go."""
