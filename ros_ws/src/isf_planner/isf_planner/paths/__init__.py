"""From loops to contours: paths of both tools for SPIF, DSIF, ADSIF and TPIF."""
