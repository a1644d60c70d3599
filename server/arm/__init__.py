"""The arm as a part of the graph: its setup, its services and its topics."""
