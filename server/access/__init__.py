"""Access: authentication and authorization of clients, and control of the arm."""
