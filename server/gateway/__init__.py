"""Gateway: the listener, and one connection a client."""
