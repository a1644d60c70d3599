"""The network side: the listener, and one connection a client."""
