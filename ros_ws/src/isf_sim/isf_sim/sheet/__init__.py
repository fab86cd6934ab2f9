"""The sheet under the tools: fine surface, contact, squeeze and what ties it to the coarse shell."""
