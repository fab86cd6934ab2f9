"""The correction methods: estimators of the springback of the coming contour."""
