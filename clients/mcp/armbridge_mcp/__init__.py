"""Model Context Protocol server for a robot arm on an armbridge server."""
