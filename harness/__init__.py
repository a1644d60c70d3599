"""Starts servers, connects clients, opens the page and judges motions, for tests and benchmarks alike."""
