"""Recorder, bags, metrics and report of formed parts."""
