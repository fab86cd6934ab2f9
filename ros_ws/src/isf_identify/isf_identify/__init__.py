"""Identification and tuning tools: dial indicator, tuning sandbox, pictures."""
