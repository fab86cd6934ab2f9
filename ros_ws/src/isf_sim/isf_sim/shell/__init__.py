"""The coarse nonlinear shell: elastic response of the formed sheet."""
