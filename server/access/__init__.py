"""Access: who a client is, what it may do, and who of them drives the arm."""
