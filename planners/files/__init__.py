"""Problem files, and the command that plans them."""
