"""Goals of clients that know only topics: their messages, topics and records."""
