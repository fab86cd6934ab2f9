"""Elastic shell model of the partly formed sheet: what a push at one point deflects before it springs back."""
