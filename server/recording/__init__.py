"""Recordings: what is published, written to MCAP files, read back and published again."""
