"""Features of the server: each is made of the context, started in order, and stopped in reverse."""
