"""Chunks of joint targets, which learned policies send: blended, followed within limits, checked before they move."""
