"""Encodings of a frame: each module decodes bytes into plain values and encodes plain values into bytes."""
