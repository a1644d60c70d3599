"""Recordings of everything that is published, in MCAP files: written, read back and replayed."""
